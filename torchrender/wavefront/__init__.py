"""The path tracer that is written in PyTorch, for BSDFs that are: see `WavefrontPathTracer` and `TorchBSDF`.

The native core answers ray queries, gives the random numbers and evaluates native BSDFs; everything else is tensor
operations on all paths of a chunk, one segment at a time, that autograd differentiates. It samples what the native path
tracer samples, with the same numbers: images of one seed are equal to rounding. The native one is tested against it
with BSDFs that are tensor operations, too, in tests/integrators/test_oracle.py.

Sampling is detached: sampled numbers, densities, weights of multiple importance sampling, Russian roulette and
visibility are constants. Each native model of shapes, lights, textures and sensors has a class or function here, in
the file of its category, registered under its type name; for BSDFs the adaptor of native_bsdf.py does.
"""
