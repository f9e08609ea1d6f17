"""The term of moving silhouettes, creases and shadows: samples on outlines, and rays on both sides of them.

The core has the samples (csrc/core/boundary): sights.h of outlines that the camera sees, vertex_sights.h of those that
points on surfaces see, shadows.h of those that lights see, which cast shadows; the CPU takes them in
csrc/cpu/boundary_*, devices in csrc/cpu/device_boundary*. Here is what is found once for all of them (outlines.py), how
many there are (allotment.py), the film (film_sums.py), what is wanted on it, radiance or other outputs (on_film.py),
and the autograd functions (boundary.py).

Where an outline crosses a pixel its colour jumps from that of the one side to that of the other. As things move the
outline sweeps over the film at the rate at which it overtakes the ray that touches it; the derivative gets the jump
times that rate, integrated along all outlines. Of light tracing points move otherwise, and other jumps count: what is
`glued`, see docs/theory/light_tracing.md.
"""
