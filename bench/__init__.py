"""Benchmarks of torchrender beside Mitsuba 3.9.1: ``python -m bench --help``."""
