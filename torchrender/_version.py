"""The version of this package, where everything else can import it from."""

__version__ = "0.1.0"
