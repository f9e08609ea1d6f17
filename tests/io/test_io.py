"""Images and volumes: what is written comes back, and bad files raise clear errors."""

import struct
import zlib

import numpy as np
import pytest
import torch

import torchrender as tr
from torchrender.image import filmic, linear_to_srgb, show, srgb_to_linear, tonemap
from torchrender.io import (
    read_channels,
    read_image,
    read_parts,
    read_volume,
    write_image,
    write_parts,
    write_volume,
)


def picture(height=7, width=11, channels=3, seed=0):
    return torch.rand(height, width, channels, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(("ending", "tolerance"), [(".exr", 0.0), (".pfm", 0.0), (".hdr", 1 / 128), (".png", 6e-3)])
def test_round_trip(tmp_path, channels, ending, tolerance):
    if (ending, channels) in {(".pfm", 4), (".hdr", 1), (".hdr", 4)}:
        with pytest.raises(ValueError, match="channels"):
            write_image(tmp_path / f"a{ending}", picture(channels=channels))
        return
    image = picture(channels=channels)
    write_image(tmp_path / f"a{ending}", image)
    back = read_image(tmp_path / f"a{ending}")
    assert back.dtype == torch.float32 and back.shape == image.shape
    assert (back - image).abs().max() <= tolerance


def test_half_exr_is_rounded_to_eleven_bits(tmp_path):
    image = picture() * 100
    write_image(tmp_path / "a.exr", image, half=True)
    back = read_image(tmp_path / "a.exr")
    assert torch.equal(back, image.half().float()) and not torch.equal(back, image)


def test_exr_layers_and_named_channels(tmp_path):
    rgb, depth, normal = picture(), picture(channels=1), picture(seed=1)
    write_image(tmp_path / "a.exr", {"": rgb, "depth": depth[..., 0], "normal": normal})
    stored = read_channels(tmp_path / "a.exr")
    assert set(stored) == {"R", "G", "B", "depth", "normal.R", "normal.G", "normal.B"}
    assert torch.equal(stored["depth"], depth[..., 0])
    assert torch.equal(read_image(tmp_path / "a.exr"), rgb)
    assert torch.equal(read_image(tmp_path / "a.exr", channels=("normal.G",)), normal[..., 1:2])
    with pytest.raises(ValueError, match=r"normal\.X"):
        read_image(tmp_path / "a.exr", channels=("normal.X",))
    write_image(tmp_path / "b.exr", picture(channels=5), channels=("a", "b", "c", "d", "e"))
    assert torch.equal(read_channels(tmp_path / "b.exr")["c"], picture(channels=5)[..., 2])
    with pytest.raises(ValueError, match="channels"):
        read_image(tmp_path / "b.exr")


@pytest.mark.parametrize("colours", [("R", "G", "B"), ("Y",), ("ultraviolet", "green", "red", "infrared", "far")])
def test_stokes_vectors(tmp_path, colours):
    """Channels of Mitsuba's names, and the same numbers back."""
    stokes = torch.randn(3, 5, len(colours), 4, generator=torch.Generator().manual_seed(1))
    write_image(tmp_path / "a.exr", stokes, channels=colours if len(colours) > 3 else None)
    stored = read_channels(tmp_path / "a.exr")
    assert set(stored) == {f"S{i}.{colour}" for i in range(4) for colour in colours}
    assert torch.equal(stored[f"S2.{colours[-1]}"], stokes[:, :, -1, 2])
    names = tr.polarization.channel_names(colours)
    assert torch.equal(read_image(tmp_path / "a.exr", channels=names).unflatten(-1, (-1, 4)), stokes)
    with pytest.raises(ValueError, match=rf"expected {len(colours)} different names of colours"):
        write_image(tmp_path / "a.exr", stokes, channels=("a", "b"))
    with pytest.raises(ValueError, match="expected shape"):
        write_image(tmp_path / "a.png", stokes)


def test_stokes_vectors_among_outputs(tmp_path):
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    scene = tr.load_dict(
        {"type": "scene", "sky": {"type": "constant"}, "sensor": {"type": "perspective", "film": film}}
    )
    out = tr.render(scene, spp=1, seed=0, outputs=("rgb", "stokes", "dolp"))
    write_image(tmp_path / "a.exr", out)
    stored = read_channels(tmp_path / "a.exr")
    assert set(stored) == {*"RGB", *(f"S{i}.{c}" for i in range(4) for c in "RGB"), *(f"dolp.{c}" for c in "RGB")}
    assert torch.equal(stored["S0.G"], out.rgb[..., 1])


@pytest.mark.parametrize("half", [False, True])
def test_exr_parts(tmp_path, half):
    left, right, depth = picture().half().float(), picture(seed=1).half().float(), picture(3, 4, 1).half().float()
    write_parts(tmp_path / "a.exr", {"left": left, "right": {"": right, "n": right}, "depth": {"z": depth}}, half=half)
    stored = read_parts(tmp_path / "a.exr")
    assert {name: sorted(channels) for name, channels in stored.items()} == {
        **{"left": ["B", "G", "R"], "right": ["B", "G", "R", "n.B", "n.G", "n.R"], "depth": ["z"]}
    }
    assert list(stored) == ["left", "right", "depth"]
    assert torch.equal(read_image(tmp_path / "a.exr"), left)
    assert torch.equal(read_image(tmp_path / "a.exr", part="right"), right)
    assert torch.equal(read_image(tmp_path / "a.exr", part="right", channels=["n.G"]), right[..., 1:2])
    assert torch.equal(read_channels(tmp_path / "a.exr", part="depth")["z"], depth[..., 0])
    with pytest.raises(ValueError, match=r"a\.exr: part: did you mean 'right'.*got 'rihgt'"):
        read_image(tmp_path / "a.exr", part="rihgt")
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "c.exr").write_bytes(content[:-20])  # the last part is cut off
    with pytest.raises(ValueError, match=r"c\.exr: .*truncated"):
        read_image(tmp_path / "c.exr")
    write_image(tmp_path / "b.exr", left, half=half)
    assert list(read_parts(tmp_path / "b.exr")) == [""]
    write_image(tmp_path / "b.png", left)
    for call, message in (
        (lambda: read_parts(tmp_path / "b.png"), "not an OpenEXR"),
        (lambda: read_image(tmp_path / "b.png", part="a"), "part: only EXR"),
        (lambda: write_parts(tmp_path / "b.png", {"a": left}), "only EXR files have parts"),
        (lambda: write_parts(tmp_path / "b.exr", {"a": left, "": left}), "expected names"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 16])
def test_png_stores_exact_integers(tmp_path, channels, bits):
    top = 2**bits - 1
    image = (picture(channels=channels) * top).round() / top
    write_image(tmp_path / "a.png", image, bits=bits, raw=True)
    assert torch.allclose(read_image(tmp_path / "a.png", raw=True), image, rtol=0, atol=1e-7)


def test_png_decodes_srgb_but_not_alpha(tmp_path):
    image = torch.full((2, 2, 4), 0.5)
    write_image(tmp_path / "a.png", image, bits=16)
    stored = read_image(tmp_path / "a.png", raw=True)
    # 1.055 * 0.5^(1/2.4) - 0.055 = 0.7353570
    assert torch.allclose(stored[..., :3], torch.tensor(0.7353570), atol=1e-5)
    assert torch.allclose(stored[..., 3], torch.tensor(0.5), atol=1e-5)
    assert torch.allclose(read_image(tmp_path / "a.png"), image, atol=2e-5)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_level_decodes_to_one_value_wherever_it_is(tmp_path, bits):
    """To that of IEC 61966-2-1. Of vectors' last elements PyTorch's `pow` may differ in the last bit."""
    levels = np.arange(256) * (1 if bits == 8 else 257)
    stored = np.concatenate([levels, levels[::-1], levels[100:131]])[None]
    write_image(tmp_path / "a.png", stored[..., None] / (2**bits - 1), bits=bits, raw=True)
    u = levels / (2**bits - 1)
    expected = np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4)
    found = read_image(tmp_path / "a.png")[0, :, 0].numpy()
    assert np.allclose(found[:256], expected, rtol=1e-6, atol=0)
    assert (found[256:] == np.concatenate([found[255::-1], found[100:131]])).all()


@pytest.mark.parametrize(("channels", "colour"), [(1, 0), (2, 4), (3, 2), (4, 6)])
def test_png16_filters(tmp_path, channels, colour):
    """Every row filter, mixed, against an encoder that follows the specification byte by byte."""
    rng = np.random.default_rng(channels)
    height, width, size = 12, 9, 2 * channels
    values = rng.integers(0, 65536, (height, width, channels), dtype=np.uint16)
    rows = values.astype(">u2").tobytes()
    stride, encoded = width * size, b""
    for y in range(height):
        row = rows[y * stride : (y + 1) * stride]
        above = rows[(y - 1) * stride : y * stride] if y else bytes(stride)
        kind, line = y % 5, bytearray()
        for i in range(stride):
            a, b = (row[i - size] if i >= size else 0), above[i]
            c = above[i - size] if i >= size else 0
            near = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            line.append((row[i] - (0, a, b, (a + b) // 2, near)[kind]) % 256)
        encoded += bytes([kind]) + line

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 16, colour, 0, 0, 0)
    path = tmp_path / "a.png"
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(encoded)), chunk(b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    expected = torch.from_numpy(values.astype(np.float32) / np.float32(65535))
    if channels == 2:
        expected = torch.cat([expected[..., :1].expand(-1, -1, 3), expected[..., 1:]], dim=-1)
    assert torch.equal(read_image(path, raw=True), expected)


def test_jpeg(tmp_path):
    image = torch.linspace(0, 1, 64).expand(64, 64).unsqueeze(-1).repeat(1, 1, 3)
    write_image(tmp_path / "a.jpg", image, quality=98)
    assert (read_image(tmp_path / "a.jpg") - image).abs().max() < 0.03
    with pytest.raises(ValueError, match="channels"):
        write_image(tmp_path / "a.jpg", picture(channels=4))


def test_hdr_large_range_and_run_length_encoding(tmp_path):
    image = picture(5, 300) * 10.0 ** torch.arange(-3, 2).reshape(5, 1, 1)
    write_image(tmp_path / "a.hdr", image)
    back = read_image(tmp_path / "a.hdr")
    assert ((back - image).abs() <= image.amax(-1, keepdim=True) / 128).all()
    # A scanline of nine pixels (2, 4, 8, exponent 130), each component stored as one run: (m / 256) * 2^2.
    line = bytes([2, 2, 0, 9]) + b"".join(bytes([128 + 9, value]) for value in (2, 4, 8, 130))
    (tmp_path / "b.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 9\n" + line)
    assert torch.equal(read_image(tmp_path / "b.hdr"), torch.tensor([2.0, 4.0, 8.0]).div(64).expand(1, 9, 3))
    (tmp_path / "c.hdr").write_bytes((tmp_path / "b.hdr").read_bytes()[:-3])
    with pytest.raises(ValueError, match="truncated"):
        read_image(tmp_path / "c.hdr")


def test_hdr_of_the_first_encoding(tmp_path):
    """Pixels (1, 1, 1, n) repeat the one before n times; the second in a row counts 256 times as much."""
    width = 600
    runs = bytes([128, 64, 32, 129]) + bytes([1, 1, 1, 86, 1, 1, 1, 2]) + bytes([0, 128, 0, 129])
    flat = bytes([64, 64, 64, 129]) * width
    content = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 600\n" + runs + flat
    (tmp_path / "a.hdr").write_bytes(content)
    image = read_image(tmp_path / "a.hdr")
    assert torch.equal(image[0, :599], torch.tensor([1.0, 0.5, 0.25]).expand(599, 3))
    assert image[0, 599].tolist() == [0, 1, 0] and torch.equal(image[1], torch.full((width, 3), 0.5))
    for bad in (content[:-1], content.replace(bytes([1, 1, 1, 86]), bytes([1, 1, 1, 88]))):
        (tmp_path / "a.hdr").write_bytes(bad)
        with pytest.raises(ValueError, match=r"a\.hdr: .*(truncated|does not fit)"):
            read_image(tmp_path / "a.hdr")


def test_pfm_rows_run_upwards_and_may_be_big_endian(tmp_path):
    (tmp_path / "a.pfm").write_bytes(b"Pf\n1 2\n1.0\n" + struct.pack(">ff", 3, 4))
    assert read_image(tmp_path / "a.pfm").flatten().tolist() == [4, 3]


@pytest.mark.parametrize("ending", [".exr", ".hdr", ".pfm", ".png", ".jpg"])
@pytest.mark.parametrize("keep", [0.0, 0.02, 0.6])
def test_truncated_files(tmp_path, ending, keep):
    write_image(tmp_path / f"a{ending}", picture(40, 50))
    content = (tmp_path / f"a{ending}").read_bytes()
    (tmp_path / f"b{ending}").write_bytes(content[: int(keep * len(content))])
    with pytest.raises(ValueError, match=f"b{ending}"):
        read_image(tmp_path / f"b{ending}")


def test_truncated_png16(tmp_path):
    write_image(tmp_path / "a.png", picture(40, 50), bits=16)
    content = (tmp_path / "a.png").read_bytes()
    for keep in (28, 40, 400, len(content) - 40):
        (tmp_path / "b.png").write_bytes(content[:keep])
        with pytest.raises(ValueError, match=r"b\.png"):
            read_image(tmp_path / "b.png")


def test_missing_unknown_and_wrong(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.png"):
        read_image(tmp_path / "nothing.png")
    with pytest.raises(IsADirectoryError, match="folder"):
        read_image(tmp_path)
    with pytest.raises(TypeError, match="path"):
        read_image(3)
    (tmp_path / "a.png").write_text("hello, this is not a picture")
    with pytest.raises(ValueError, match="expected EXR"):
        read_image(tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"\.xyz"):
        write_image(tmp_path / "a.xyz", picture())
    with pytest.raises(TypeError, match="floating-point"):
        write_image(tmp_path / "a.png", torch.zeros(2, 2, 3, dtype=torch.uint8))
    with pytest.raises(ValueError, match=r"\(3, 2, 2, 3\)"):
        write_image(tmp_path / "a.png", torch.zeros(3, 2, 2, 3))
    with pytest.raises(FileNotFoundError, match="folder"):
        write_image(tmp_path / "no" / "a.png", picture())


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("ending", [".vol", ".npy"])
def test_volume_round_trip(tmp_path, channels, ending):
    volume = torch.rand(2, 3, 4, channels)
    write_volume(tmp_path / f"a{ending}", volume)
    assert torch.equal(read_volume(tmp_path / f"a{ending}"), volume)
    content = (tmp_path / f"a{ending}").read_bytes()
    (tmp_path / f"b{ending}").write_bytes(content[:-5])
    with pytest.raises(ValueError, match="truncated"):
        read_volume(tmp_path / f"b{ending}")


def test_vol_layout(tmp_path):
    """x runs fastest, then y, then z; the header is the documented one."""
    header = b"VOL" + struct.pack("<Biiiii6f", 3, 1, 2, 1, 3, 1, *range(6))
    (tmp_path / "a.vol").write_bytes(header + struct.pack("<6f", *range(6)))
    volume = read_volume(tmp_path / "a.vol")
    assert volume.shape == (3, 1, 2, 1) and volume[2, 0, 1, 0] == 5 and volume[1, 0, 0, 0] == 2
    (tmp_path / "b.vol").write_bytes(header.replace(b"VOL\x03", b"VOL\x02"))
    with pytest.raises(ValueError, match="version 3"):
        read_volume(tmp_path / "b.vol")
    with pytest.raises(ValueError, match=r"\.txt"):
        write_volume(tmp_path / "a.txt", volume)


def test_srgb_curve():
    values = torch.tensor([0.0, 0.002, 0.0031308, 0.18, 0.5, 1.0], dtype=torch.float64)
    expected = torch.tensor([0.0, 0.02584, 0.040449936, 0.461356129, 0.735356983, 1.0], dtype=torch.float64)
    assert torch.allclose(linear_to_srgb(values), expected, atol=1e-8)
    assert torch.allclose(srgb_to_linear(linear_to_srgb(values)), values, atol=1e-7)
    x = torch.tensor([-0.1, 0.0, 0.01, 0.7, 1.5], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(linear_to_srgb, x)
    assert torch.autograd.gradcheck(srgb_to_linear, x)


def test_tonemap_and_show():
    image = torch.rand(3, 4, 3, dtype=torch.float64) + 0.1
    stops = torch.tensor(-0.5, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda i, s: tonemap(i, s, clip=False), (image.requires_grad_(), stops))
    assert torch.allclose(tonemap(image, 1.0), linear_to_srgb(2 * image).clamp(0, 1))
    rgba = torch.full((2, 2, 4), 0.25)
    assert torch.allclose(tonemap(rgba)[..., 3], torch.tensor(0.25))
    assert tonemap(rgba)[0, 0, 0] > 0.5
    shown = show([torch.full((2, 3, 3), 0.5), torch.ones(2, 5, 1)])
    assert shown.size == (8, 2) and shown.getpixel((0, 0)) == (188, 188, 188) and shown.getpixel((4, 0))[0] == 255
    with pytest.raises(ValueError, match="one height"):
        show([torch.ones(2, 3, 3), torch.ones(3, 3, 3)])
    with pytest.raises(TypeError, match="floating-point"):
        tonemap(torch.ones(2, 2, 3, dtype=torch.uint8))


# ------------------------------------------------------------------------------------------------------------ filmic
def hable(x):
    """As on his slides: shoulder strength 0.15, linear strength 0.5 and angle 0.1, toe 0.2, 0.02 / 0.3."""
    return (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.5) + 0.06) - 1 / 15


def test_filmic_curve():
    values = torch.tensor([0.0, 0.01, 0.18, 1.0, 3.0, 5.6], dtype=torch.float64)
    found = filmic(values)
    assert torch.allclose(found, hable(2 * values) / hable(11.2), atol=1e-12)
    assert float(found[0]) == pytest.approx(0, abs=1e-15) and float(found[-1]) == pytest.approx(1)
    assert found.tolist()[2:4] == pytest.approx([0.128338, 0.492919], abs=1e-6)
    x = torch.tensor([-0.5, -1e-4, 1e-4, 0.3, 4.0, 60.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(filmic, x)
    # one tangent from either side of 0, and none of both
    zero = torch.zeros(3, dtype=torch.float64) + torch.tensor([-1e-9, 0.0, 1e-9], dtype=torch.float64)
    (slope,) = torch.autograd.grad(filmic(zero.requires_grad_()).sum(), zero)
    assert torch.allclose(slope, slope[1].expand(3), rtol=1e-6)
    assert float(slope[1]) == pytest.approx(2 * hable(1e-7) / hable(11.2) / 1e-7, rel=1e-5)
    rising = filmic(torch.cat([torch.linspace(-1, 8, 1001), torch.logspace(1, 38, 400)]))
    assert bool((rising.diff() >= 0).all()) and bool(torch.isfinite(rising).all())
    assert float(filmic(torch.tensor(float("inf")))) == pytest.approx(14 / 15 / hable(11.2), rel=1e-5)


def test_filmic_pictures(tmp_path):
    image = torch.linspace(0, 6, 5 * 7 * 3).reshape(5, 7, 3)
    expected = linear_to_srgb(filmic(image)).clamp(0, 1)
    assert torch.allclose(tonemap(image, curve="filmic"), expected)
    assert torch.allclose(tonemap(image / 4, 2.0, curve="filmic"), expected, atol=1e-6)
    assert tonemap(image, curve="filmic", clip=False).max() > 1 and tonemap(image, clip=False).max() > 1
    assert torch.autograd.gradcheck(lambda i: tonemap(i, curve="filmic", clip=False), image.double().requires_grad_())
    bytes_of = (expected * 255 + 0.5).to(torch.uint8)
    write_image(tmp_path / "a.png", image, tonemap="filmic")
    assert torch.equal((read_image(tmp_path / "a.png", raw=True) * 255).round().to(torch.uint8), bytes_of)
    write_image(tmp_path / "b.png", image, tonemap="filmic", bits=16)
    assert float((read_image(tmp_path / "b.png", raw=True) - expected).abs().max()) < 1e-4
    write_image(tmp_path / "a.jpg", torch.ones(8, 8, 3), tonemap="filmic", quality=100)
    assert float(read_image(tmp_path / "a.jpg", raw=True).mean()) == pytest.approx(0.731, abs=0.005)
    shown = show(image, tonemap="filmic")
    assert np.array_equal(np.asarray(shown), bytes_of)
    rgba = torch.cat([image, torch.full((5, 7, 1), 0.25)], -1)
    assert torch.allclose(tonemap(rgba, curve="filmic")[..., 3], torch.tensor(0.25))
    for call in (
        lambda: tonemap(image, curve="aces"),
        lambda: show(image, tonemap="aces"),
        lambda: write_image(tmp_path / "c.png", image, tonemap="aces"),
    ):
        with pytest.raises(ValueError, match="expected 'srgb' or 'filmic', got 'aces'"):
            call()
    for name, options in (("c.exr", {}), ("c.hdr", {}), ("c.png", {"raw": True})):
        with pytest.raises(ValueError, match="'filmic' is for PNG and JPEG without raw=True"):
            write_image(tmp_path / name, image, tonemap="filmic", **options)
    assert not list(tmp_path.glob("c.*"))
