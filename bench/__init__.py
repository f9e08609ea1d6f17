"""Benchmarks of torchrender, by itself or beside other renderers: ``python -m bench`` lists them."""
