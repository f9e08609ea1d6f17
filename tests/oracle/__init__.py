"""What native renderings are compared with and the package itself does not have: BSDFs, outputs of first
hits, light tracing, media, samplers, polarised light and spectra, slow and obvious, in plain tensor operations in
float64 that autograd differentiates.

Lights, textures and cameras are those of `torchrender.wavefront`, whose path tracer, with the BSDFs of `bsdf` in place
of the native ones, is the oracle of the native one: test_oracle.py.
"""
