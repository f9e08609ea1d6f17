"""What native renderings are compared with and the package itself does not have: outputs of first hits, light tracing,
media and samplers, slow and obvious, in plain tensor operations in float64 that autograd differentiates.

Models of surfaces and lights, textures and cameras are those of `torchrender.wavefront`, whose path tracer is the
oracle of the native one: test_oracle.py.
"""
