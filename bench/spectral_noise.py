"""Scenes whose noise is that of wavelengths, or of wavelengths and paths, as files that all programs read."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .rows import Row

_SCENE = """<scene version="3.0.0">
    <default name="resolution" value="256"/>
    <default name="spp" value="16"/>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="$resolution"/>
            <integer name="height" value="$resolution"/>
            <string name="component_format" value="float32"/>
            <rfilter type="box"/>
        </film>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    </sensor>
    <bsdf type="diffuse" id="grey"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf>
    <bsdf type="diffuse" id="red"><rgb name="reflectance" value="0.7, 0.2, 0.1"/></bsdf>
    <bsdf type="diffuse" id="blue"><rgb name="reflectance" value="0.1, 0.3, 0.7"/></bsdf>
    <shape type="rectangle" id="wall">
        <transform name="to_world"><scale value="9"/><translate z="-2"/></transform>
        <ref id="grey"/>
    </shape>
    <shape type="sphere" id="left">
        <point name="center" x="-0.9" y="0" z="0"/>
        <float name="radius" value="0.8"/>
        <ref id="red"/>
    </shape>
    <shape type="sphere" id="right">
        <point name="center" x="0.9" y="0" z="0"/>
        <float name="radius" value="0.8"/>
        <ref id="blue"/>
    </shape>
    {light}
</scene>
"""

# Three lines of 2 nm and a weak continuous spectrum, as of a fluorescent lamp: pairs of nm and power.
_LINES = [(380, 0.05), (780, 0.05)]
for _at, _power in ((436, 20.0), (546, 40.0), (611, 40.0)):
    _LINES += [(_at - 2, 0.05), (_at - 1, _power), (_at + 1, _power), (_at + 2, 0.05)]
_PAIRS = ", ".join(f"{at}:{power}" for at, power in sorted(_LINES))
_DAY = '<rgb name="{name}" value="2, 2, 2"/>'
_LAMP = f'<spectrum name="{{name}}" value="{_PAIRS}"/>'
_SUN = '<emitter type="directional"><vector name="direction" x="-0.3" y="-0.2" z="-1"/>{colour}</emitter>'
_SKY = '<emitter type="constant">{colour}</emitter>'
_AREA = """<shape type="rectangle" id="lamp">
        <transform name="to_world"><lookat origin="1, 3, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <emitter type="area">{colour}</emitter>
    </shape>"""

LIGHTS = {
    "sun, daylight": _SUN.format(colour=_DAY.format(name="irradiance")),
    "sky, daylight": _SKY.format(colour=_DAY.format(name="radiance")),
    "sun, three lines": _SUN.format(colour=_LAMP.format(name="irradiance")),
    "lamp, three lines": _AREA.format(colour=_LAMP.format(name="radiance")),
}


@contextmanager
def noise_rows() -> Iterator[list[Row]]:
    """Rows of these scenes, whose files exist inside of a ``with`` block."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        rows = []
        for i, (name, light) in enumerate(LIGHTS.items()):
            file = Path(folder) / f"light_{i}.xml"
            file.write_text(_SCENE.format(light=light))
            rows.append(Row(name, str(file), ("red.reflectance.value",)))
        yield rows
