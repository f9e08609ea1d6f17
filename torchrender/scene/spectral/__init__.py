"""The spectral variant: what its colours become for the core, and at which wavelengths it looks at them."""
