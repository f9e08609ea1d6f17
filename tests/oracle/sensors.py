"""Sensors: functions of the world, the sensor's record, film size, film and lens positions (N, 2), to rays.

They are those of the integrator in PyTorch; tests/test_lens_rays.py holds their rays against closed forms.
"""

from __future__ import annotations

from torchrender.wavefront.sensors import SENSORS

__all__ = ["SENSORS"]
