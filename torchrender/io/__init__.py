"""Images and volumes from and to files."""

from .image import read_channels, read_image, write_image
from .volume import read_volume, read_volume_bounds, write_volume

__all__ = ["read_channels", "read_image", "read_volume", "read_volume_bounds", "write_image", "write_volume"]
