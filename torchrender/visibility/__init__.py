"""The term of moving silhouettes, creases and shadows: samples on outlines, and rays on both sides of them.

seen.py has the outlines that the camera sees, vertices.py those that points on surfaces see, lights.py those that
lights see, which cast shadows; boundary.py sums them up. Of what the camera sees:

Where an outline crosses a pixel its colour jumps from that of the one side to that of the other. As things move the
outline sweeps over the film at the rate at which it overtakes the ray that touches it; the derivative gets the jump
times that rate, integrated along all outlines:

    dI = integral of h(p - u) / Z  w sin  (L_minus - L_plus)  n.(dB - do - r dd)  dl

with the outline's point B and unit tangent e, the ray's origin o, unit direction d and distance r, sin = |d x e|, the
normal n = d x e / sin of the outline across the ray, w pixels per area perpendicular to the ray, the filter h at the
place u on the film, and the radiances L on both sides of the outline, towards -n and n.
"""
