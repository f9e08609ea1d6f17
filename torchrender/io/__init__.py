"""Images, volumes and spectra from and to files."""

from .image import read_channels, read_image, read_parts, write_image, write_parts
from .spectrum import write_spectrum
from .video import write_video
from .volume import read_volume, read_volume_bounds, write_volume

__all__ = [
    "read_channels",
    "read_image",
    "read_parts",
    "read_volume",
    "read_volume_bounds",
    "write_image",
    "write_parts",
    "write_spectrum",
    "write_video",
    "write_volume",
]
