"""The benchmark program as a user runs it: its list, its arguments, and every benchmark at tiny settings."""

from __future__ import annotations

import dataclasses
import importlib
import json
import platform
import sys

import pytest

from bench import report
from bench.__main__ import BENCHMARKS, main
from bench.rows import ROWS
from bench.spectral_noise import LIGHTS

TINY = ["--resolution", "16", "--spp", "2", "--rounds", "2", "--warmup", "1", "--threads", "1"]


def run(tmp_path, *arguments: str) -> dict:
    """What a benchmark writes as JSON."""
    file = tmp_path / "result.json"
    assert main([*arguments, "--json", str(file)]) == 0
    return json.loads(file.read_text())


def test_rows_name_existing_files_and_parameters():
    import torchrender as tr

    for row in ROWS:
        scene = tr.load_file(row.path, resolution=8, **row.arguments)
        for name in row.parameters:
            assert scene.get_parameter(name).ndim in (1, 3), name
    shapes = [tr.load_file(row.path, **row.arguments).get_parameter(row.parameters[0]).shape[0] for row in ROWS[1:]]
    assert shapes == [512, 1024, 512, 1024]


def test_the_list_names_every_benchmark(capsys):
    assert main([]) == 0
    printed = capsys.readouterr().out
    for name in (*BENCHMARKS, "compare"):
        assert f"\n  {name} " in printed
    folder = report.ROOT / "bench"
    modules = {p.stem for p in folder.glob("*.py") if "def add_arguments" in p.read_text()}
    assert modules == set(BENCHMARKS)
    for name in BENCHMARKS:
        assert importlib.import_module(f"bench.{name}").__doc__


def test_an_unknown_benchmark_is_refused(capsys):
    assert main(["table3"]) == 2
    assert "no benchmark 'table3'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["table2", "--rounds", "0"],
        ["table2", "--filter", "sharp"],
        ["table2", "--spp", "-1"],
        ["table2", "--resolution", "wide"],
        ["table2", "--json", "/no/such/folder/a.json"],
        ["table2", "--json", "/"],
        ["table2", "--plot", "picture.bmp"],
        ["table2", "--peer", "blender=python"],
        ["rays", "--peer", "mitsuba=python"],
        ["memory", "--samples", "0"],
        ["table2", "--set", "correlated"],
        ["table2", "--set", "outputs=rgb"],
    ],
)
def test_wrong_arguments_end_before_any_work(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert "error" in capsys.readouterr().err


def test_a_peer_that_does_not_start_ends_the_program(capsys):
    assert main(["table2", *TINY, "--peer", "mitsuba=/no/such/python"]) == 2
    assert "/no/such/python" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["gaussian", "lanczos"])
def test_table2_with_another_filter(tmp_path, name):
    result = run(tmp_path, "table2", *TINY, "--only", "Cornell", "--filter", name)
    assert f"{name} filter" in result["tables"][0]["title"]


def test_redner_has_box_filters_alone():
    with pytest.raises(SystemExit, match="--filter: Redner has box filters alone, got tent"):
        main(["table2", *TINY, "--filter", "tent", "--peer", "redner=python"])


def test_a_scene_that_does_not_exist_is_refused():
    with pytest.raises(SystemExit, match="no scene's name contains 'bunny'"):
        main(["table2", *TINY, "--only", "bunny"])


def test_table2_with_a_peer(tmp_path, capsys, fake_peer):
    picture = tmp_path / "table.png"
    options = ["--only", "Cornell", "--peer", f"mitsuba={sys.executable}", "--plot", str(picture)]
    result = run(tmp_path, "table2", *TINY, *options)
    seconds, ratios = result["tables"]
    (row,) = seconds["rows"]
    assert row["scene"] == ROWS[0].name
    assert row["Mitsuba sum s"]["median"] == 2.0
    ours = row["sum s"]["median"]
    assert row["forward s"]["n"] == 2
    assert 0 < row["Embree alone, image s"]["median"] < row["Embree alone, sum s"]["median"] < 10
    (ratio,) = ratios["rows"]
    assert ratio["Mitsuba sum / ours"] == pytest.approx(2 / ours)
    assert ratio["our sum / Embree alone"] == pytest.approx(ours / row["Embree alone, sum s"]["median"])
    assert 0 < ratio["lanes in use, image"] <= 1 and 0 < ratio["lanes in use, derivative"] <= 1
    assert result["versions"]["python"] == platform.python_version()
    assert result["versions"]["mitsuba"] == "0.0"
    assert {"torch", "torchrender", "embree", "numpy", "instruction set"} <= result["versions"].keys()
    assert {"cpu", "cores", "load"} <= result["machine"].keys()
    printed = capsys.readouterr().out
    assert "| Cornell box" in printed and "1 threads" in printed
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_images_with_a_peer(tmp_path, fake_peer):
    options = ["--only", "Cornell", "--peer", f"mitsuba={sys.executable}", "--variant", "cuda_ad_rgb"]
    (table,) = run(tmp_path, "images", *TINY, *options, "--gradients")["tables"]
    (row,) = table["rows"]
    assert row["Mitsuba image s"]["median"] == 0.5 and row["image s"]["n"] == 2
    assert row["Mitsuba / ours, image"] == pytest.approx(0.5 / row["image s"]["median"])
    ratio = row["Mitsuba sum s"]["median"] / row["sum s"]["median"]
    assert row["Mitsuba / ours, sum"] == pytest.approx(ratio) and ratio > 0
    assert "backend cpu, Mitsuba's variant cuda_ad_rgb" in table["title"]


def test_polarized_with_a_peer(tmp_path, fake_peer):
    options = ["--only", "gold", "--peer", f"mitsuba={sys.executable}"]
    tables = run(tmp_path, "polarized", *TINY, *options, "--samples", "3")["tables"]
    (row,), (ratio,), (memory,) = (table["rows"] for table in tables)
    image = row["rgb_polarized image s"]["median"]
    assert ratio["polarised image / rgb"] == pytest.approx(image / row["rgb image s"]["median"])
    expected = row["rgb_polarized gradient s"]["median"] / (2 * image)
    assert ratio["polarised gradient / two polarised images"] == pytest.approx(expected)
    for what in ("image", "gradient"):
        expected = row[f"Mitsuba {what} s"]["median"] / row[f"mono_polarized {what} s"]["median"]
        assert ratio[f"Mitsuba {what} / mono_polarized"] == pytest.approx(expected)
    assert memory["spp"] == 3 and memory["mono_polarized MiB"]["median"] > 0 <= memory["Mitsuba MiB"]["median"]


def test_spectral_with_a_peer(tmp_path, fake_peer):
    options = ["--only", "sphere, texture 512", "--peer", f"mitsuba={sys.executable}"]
    seconds, ratios = run(tmp_path, "spectral", *TINY, *options)["tables"]
    (row,), (ratio,) = seconds["rows"], ratios["rows"]
    assert row["scene"] == ROWS[1].name and row["Mitsuba both s"]["median"] == 2.0
    for column, name in (("image", "image"), ("gradient", "gradient")):
        expected = row[f"spectral {column} s"]["median"] / row[f"rgb {column} s"]["median"]
        assert ratio[f"spectral {name} / rgb"] == pytest.approx(expected)
    assert ratio["Mitsuba both / spectral"] == pytest.approx(2 / row["spectral both s"]["median"])
    (noise,) = run(tmp_path, "spectral", *TINY, "--part", "noise", *options[2:])["tables"]
    assert [row["scene"] for row in noise["rows"]] == list(LIGHTS)
    for row in noise["rows"]:
        assert row["spectral variance"] > 0
        assert row["Mitsuba variance"] == pytest.approx((0.01 / 0.91) ** 2 * 3, rel=1e-3)  # of 0.3, 0.31, 0.3
        cost = row["spectral variance"] * row["spectral image s"]["median"]
        expected = row["Mitsuba variance"] * 0.5 / cost
        assert row["Mitsuba time to equal error / spectral"] == pytest.approx(expected)


def test_spectral_alone(tmp_path, capsys):
    tables = run(tmp_path, "spectral", *TINY, "--part", "time", "--only", "texture 512")["tables"]
    assert [len(table["rows"]) for table in tables] == [2, 2]
    assert not any("Mitsuba" in column for table in tables for column in table["columns"])
    assert main(["spectral", *TINY, "--peer", f"torchrender={sys.executable}"]) == 2
    assert "torchrender has no spectral variant" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="variances need two rounds"):
        main(["spectral", *TINY, "--rounds", "1"])


def test_distributed(tmp_path):
    options = ["--resolution", "16", "--spp", "2", "--rounds", "1", "--warmup", "0", "--only", "Cornell"]
    speed, sums, model = run(tmp_path, "distributed", *options)["tables"]
    one, two = speed["rows"]
    assert (one["processes"], two["processes"]) == (1, 2)
    # image and 15 albedos, and seven numbers that processes agree about
    assert one["bytes a process sends a step"] == 0
    assert two["bytes a process sends a step"] == 4 * (16 * 16 * 3 + 15) + 8 * 7
    assert two["speed / 1, by time"] == pytest.approx(one["step s"]["median"] / two["step s"]["median"])
    apart = "sharing nothing, by time"
    assert one[apart] == 1 and two[apart] > 0
    assert [row["bytes"] for row in sums["rows"]] == [1 << 10, 1 << 16, 1 << 20, 1 << 24]
    assert [row["machines"] for row in model["rows"]] == 2 * [1, 8, 64]
    for row in model["rows"]:
        assert row["step s"] == pytest.approx(row["samples s"] + row["by each alone s"] + row["sums s"])
    with pytest.raises(SystemExit, match="--processes: two numbers or more"):
        main(["distributed", "--processes", "2"])


def test_endurance(tmp_path):
    (table,) = run(tmp_path, "endurance", "--steps", "220")["tables"]
    assert len(table["rows"]) == 20 and all(row["resident MB"] > 50 for row in table["rows"])
    assert table["rows"][-1]["steps"] == 220 and "over 220 steps" in table["notes"][0]


def test_fuzz(tmp_path):
    (table,) = run(tmp_path, "fuzz", "--only", "exr ", "--count", "20", "--processes", "2")["tables"]
    assert [row["kind"] for row in table["rows"]] == ["exr channels", "exr parts"]
    for row in table["rows"]:
        assert row["inputs"] == 20 and 0 < row["refused"] <= 20 and row["found"] == 0
    with pytest.raises(SystemExit, match="--only: no kind's name contains 'tiff'"):
        main(["fuzz", "--only", "tiff"])


def test_table2_alone_with_settings(tmp_path):
    result = run(tmp_path, "table2", *TINY, "--only", "Cornell", "--set", "correlated=True", "--set", "nan=raise")
    (row,) = result["tables"][0]["rows"]
    assert not any("Mitsuba" in column for column in row)
    assert result["settings"]["renderer"] == [["correlated", True], ["nan", "raise"]]


def test_settings_that_do_not_exist_are_refused():
    for name in ("table2", "coldstart"):  # here, and in a process of its own
        with pytest.raises(SystemExit, match="--set: Renderer: unknown argument 'colour'"):
            main([name, *TINY, "--set", "colour=True"])


def test_numbers_are_sorted(tmp_path):
    options = ["--only", "Cornell", "--part", "pixels", "--sides", "16", "8", "16"]
    (table,) = run(tmp_path, "scaling", *TINY, *options)["tables"]
    assert [row["pixels"] for row in table["rows"]] == ["8²", "16²"]
    with pytest.raises(SystemExit, match="'Cornell' has a texture, which --part asks for"):
        main(["scaling", *TINY, "--only", "Cornell", "--part", "texture"])


def test_gradients_with_a_peer(tmp_path, fake_peer):
    options = ["--only", "sphere, texture 512", "--peer", f"mitsuba={sys.executable}"]
    (row,) = run(tmp_path, "gradients", *TINY, *options)["tables"][0]["rows"]
    assert row["parameter"] == ROWS[1].parameters[0]
    assert row["Mitsuba gradient"] == pytest.approx(1.05)
    assert row["gradient"] > 0 and row["Mitsuba time s"]["median"] == 2.0


def test_a_single_round_has_no_deviation(tmp_path, fake_peer):
    options = ["--rounds", "1", "--only", "Cornell", "--peer", f"mitsuba={sys.executable}"]
    for row in run(tmp_path, "gradients", *TINY, *options)["tables"][0]["rows"]:
        assert row["gradient"] > 0
        assert all(row[name] is None for name in ("deviation", "Mitsuba deviation", "Mitsuba z"))


def test_overhead(tmp_path):
    rows = run(tmp_path, "overhead", *TINY, "--only", "512")["tables"][0]["rows"]
    assert [row["scene"] for row in rows] == [ROWS[1].name, ROWS[3].name]
    for row in rows:
        assert 0 < row["forward ms"]["median"] < row["forward + backward ms"]["median"] < 1000
        assert 0 < row["with a changed parameter ms"]["median"] < 1000


def test_coldstart(tmp_path):
    options = ["--only", "Cornell", "--rounds", "1", "--warmup", "0"]
    (row,) = run(tmp_path, "coldstart", *TINY, *options)["tables"][0]["rows"]
    parts = [row[f"{name} s"]["median"] for name in ("import", "load", "first step")]
    assert row["total s"]["median"] == pytest.approx(sum(parts))
    assert all(0 < part < 60 for part in parts)


def test_memory(tmp_path, fake_peer, forks):
    options = [
        "--only",
        "sphere, texture 1024",
        "--rounds",
        "1",
        "--samples",
        "2",
        "--peer",
        f"mitsuba={sys.executable}",
    ]
    (row,) = run(tmp_path, "memory", *TINY, *options)["tables"][0]["rows"]
    assert 0 <= row["Mitsuba peak above the loaded scene MiB"]["median"] < 10  # what takes its place does nothing
    assert (
        row["gradients and a buffer a thread MiB"] == 24
    )  # 1024 x 1024 x 3 numbers of 4 bytes, with one thread, twice
    assert 0 <= row["beyond these MiB"]["median"] < row["peak above the loaded scene MiB"]["median"] < 1000


def test_scaling(tmp_path, fake_peer):
    options = ["--only", "sphere, texture 512", "--samples", "1", "2", "--sides", "8", "16", "--triangles", "500"]
    options += ["--peer", f"mitsuba={sys.executable}"]
    picture = tmp_path / "scaling.svg"
    result = run(tmp_path, "scaling", *TINY, *options, "--texels", "16", "32", "--plot", str(picture))
    assert [table["part"] for table in result["tables"]] == ["samples", "pixels", "threads", "triangles", "texture"]
    samples, pixels, threads, triangles, texture = (table["rows"] for table in result["tables"])
    assert [(row["program"], row["samples"]) for row in samples[1:3]] == [("ours", 8192), ("Mitsuba", 4096)]
    assert [row["samples"] for row in pixels] == [128, 512] * 2
    assert [row["fixed cost, in ms"] for row in pixels[2:]] == pytest.approx([2000, 2000])
    assert [row["number"] for row in threads] == [1]
    assert triangles[0]["our growth"] == triangles[0]["ours / Embree's"] == 1
    assert triangles[0]["Embree alone, a ray ns"]["median"] > 0
    assert [row["texels"] for row in texture] == [16, 32]
    assert texture[0]["growth of a step, in ms"] == 0
    assert b"<svg" in picture.read_bytes()


def test_variance(tmp_path):
    options = ["--only", "Cornell", "--samples", "2", "8", "--reference", "256"]
    rows = run(tmp_path, "variance", *TINY, *options)["tables"][0]["rows"]
    assert {row["of"] for row in rows} == {"image", "gradient"}
    first = rows[0]
    assert first["program"] == "ours, independent"
    assert first["relative to the first"] == 1
    assert 0 < first["error, 8 spp"] < first["error, 2 spp"] < 10  # a factor of 2, of 768 numbers in 2 rounds
    with pytest.raises(SystemExit, match="Mitsuba's samplers take powers of four, got 2"):
        run(tmp_path, "variance", *TINY, *options, "--peer", f"mitsuba={sys.executable}")


def test_smoke(tmp_path, fake_peer):
    options = ["--size", "8", "--spp-grad", "1", "--passes", "2", "--seconds", "1", "--target", "8", "--rounds", "1"]
    result = run(tmp_path, "smoke", *TINY, *options, "--peer", f"mitsuba={sys.executable}")
    iteration, reconstruction = (table["rows"] for table in result["tables"])
    assert [row["program"] for row in iteration] == ["ours", "Mitsuba"]
    ours, other = iteration
    assert 0 < ours["forward s"]["median"] < 10 and 0 < ours["backward s"]["median"] < 10
    assert ours["not finite, image"] == ours["not finite, gradient"] == 0
    assert other["sum s"]["median"] == 2 * 2.0 and other["not finite, image"] == 2 * 3
    ours, other = reconstruction
    assert ours["iterations"] > 2 and ours["not finite, gradient"] == 0
    # every gradient of what takes Mitsuba's place is NaN in all voxels, on one grid or two
    assert other["iterations"] == 2 and other["not finite, gradient"] in (2 * 2**3, 2**3 + 4**3)
    names = ("PSNR of the held-back view dB", "gain of ours dB")
    assert other[names[1]] == pytest.approx(ours[names[0]] - other[names[0]])
    assert ours[names[0]] > 10


def test_materials(tmp_path, fake_peer):
    options = ["--only", "redner", "--peer", f"mitsuba={sys.executable}"]
    (table,) = run(tmp_path, "materials", *TINY, *options)["tables"]  # nothing to compare it with
    (row,) = table["rows"]
    assert row["material"] == "redner" and not any("Mitsuba" in column for column in row)
    options = [
        "--only",
        "roughplastic, ggx",
        "--seeds",
        "4",
        "--check-spp",
        "64",
        "--peer",
        f"mitsuba={sys.executable}",
    ]
    time, images, gradients = (table["rows"] for table in run(tmp_path, "materials", *TINY, *options)["tables"])
    (row,) = time
    ours = row["sum s"]["median"]
    assert 0 < row["image s"]["median"] < 10 and row["sum s"]["n"] == 2
    assert row["Mitsuba sum s"]["median"] == 2.0
    # Ratios of the two rounds lie half the distance between their quartiles beyond these; what belongs to the mean of
    # the two times is their harmonic mean.
    q1, q3 = (row["Mitsuba / ours, sum"][name] for name in ("q1", "q3"))
    low, high = q1 - (q3 - q1) / 2, q3 + (q3 - q1) / 2
    assert 2 / (1 / low + 1 / high) == pytest.approx(2 / ours)
    (row,) = images
    expected = 100 * abs(0.305 / row["mean of the picture"] - 1)
    assert row["Mitsuba: difference of the means %"] == pytest.approx(expected, rel=1e-3)
    assert row["Mitsuba: blocks, largest z"] >= row["Mitsuba: blocks, root mean square of z"] > 3
    assert [row["parameter"].rpartition(".")[0] for row in gradients][:1] == ["material.diffuse_reflectance"]
    for row in gradients:  # what takes Mitsuba's place finds 1.05 everywhere, our own differences find our gradient
        assert row["Mitsuba gradient"] == pytest.approx(1.05) and abs(row["Mitsuba z"]) > 5
        assert row["finite difference"] == pytest.approx(row["gradient"], rel=0.15)


def test_materials_are_not_redners(fake_peer, monkeypatch, capsys):
    from bench import peers

    monkeypatch.setitem(peers.KNOWN, "mitsuba", dataclasses.replace(peers.KNOWN["mitsuba"], reads_arrays=True))
    assert main(["materials", *TINY, "--peer", f"mitsuba={sys.executable}"]) == 2
    assert "Mitsuba has one material only" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="no material's name contains 'velvet'"):
        main(["materials", *TINY, "--only", "velvet"])


def test_slab(tmp_path, fake_peer):
    options = ["--size", "2", "8", "8", "--spp-grad", "1", "--passes", "2", "--peer", f"mitsuba={sys.executable}"]
    ours, other = run(tmp_path, "slab", *TINY, *options)["tables"][0]["rows"]
    assert ours["scene"] == "slab, 2 x 8 x 8 albedos"
    assert ours["sum s"]["n"] == 2 and 0 < ours["sum s"]["median"] < 10
    assert other["sum / ours"] == pytest.approx(2 / ours["sum s"]["median"])
    assert ours["not finite, image"] == ours["not finite, gradient"] == 0
    assert other["not finite, image"] == 6


def test_volume_gradients(tmp_path, fake_peer, forks):
    options = ["--size", "8", "--seeds", "4", "--reference", "64", "--differences", "2", "--rounds", "1"]
    result = run(tmp_path, "volume_gradients", *TINY, *options, "--peer", f"mitsuba={sys.executable}")
    time, variance, bias, memory = (table["rows"] for table in result["tables"])
    assert time[1]["sum / ours"] == pytest.approx(2 / time[0]["sum s"]["median"])
    assert variance[0]["variance x s"] > 0 and variance[0]["variance x s / ours"] == 1
    # 0.001 and 0.002 in turns: a variance of 1 / 3 of 10^-6, twice a second's
    assert variance[1]["variance x s"] == pytest.approx(2e-6 / 3)
    assert variance[1]["not finite"] == 0
    cells = {row["cells"]: row for row in bias}
    assert cells["all"]["number"] == 8**3
    assert sum(cells[name]["number"] for name in ("empty", "thin", "dense")) == 8**3
    assert cells["all"]["Mitsuba: sum"] == pytest.approx(1.5e-3 * 8**3)
    assert cells["64 blocks, largest absolute z"]["ours: z"] >= cells["64 blocks, root mean square of z"]["ours: z"] > 0
    assert memory[0]["parameter and gradient MiB"] == pytest.approx(2 * 8**3 * 4 / 2**20)
    assert 0 < memory[0]["peak above the loaded scene MiB"]["median"] < 1000


def test_media_are_not_redners(tmp_path, fake_peer, monkeypatch, capsys):
    from bench import peers

    monkeypatch.setitem(peers.KNOWN, "mitsuba", dataclasses.replace(peers.KNOWN["mitsuba"], reads_arrays=True))
    assert main(["slab", *TINY, "--size", "1", "4", "4", "--peer", f"mitsuba={sys.executable}"]) == 2
    assert "Mitsuba has no participating media" in capsys.readouterr().err


def test_caustics(tmp_path, fake_peer, forks, capsys):
    options = ["--size", "16", "--spp-grad", "2", "--seeds", "3", "--peer", f"mitsuba={sys.executable}"]
    time, memory, check = (table["rows"] for table in run(tmp_path, "caustics", *TINY, *options)["tables"])
    assert [row["program"] for row in time] == ["ours", "Mitsuba"]
    assert time[0]["sum s"]["n"] == 2 and 0 < time[0]["sum s"]["median"] < 10
    assert time[1]["sum / ours"] == pytest.approx(2 / time[0]["sum s"]["median"])
    assert 0 < time[0]["distance after"] < 10 and time[1]["distance after"] == 2
    assert time[0]["not finite, image"] == time[0]["not finite, gradient"] == 0 and time[1]["not finite, image"] == 2
    ours, other = memory
    assert 0 <= ours["of that, beyond the loaded scene MiB"] < ours["peak of the process MiB"] < 5000
    assert other["peak / ours"] == pytest.approx(other["peak of the process MiB"] / ours["peak of the process MiB"])
    # the same paths, so that three seeds tell: what is left is the difference quotient's own error
    differences = [abs(row["derivative"] - row["finite difference"]) for row in check]
    assert len(check) == 3 and max(differences) < 0.03 * max(abs(row["derivative"]) for row in check)
    passes = ["--size", "8", "--part", "time", "--passes", "2", "--peer", f"mitsuba={sys.executable}"]
    assert main(["caustics", *TINY, *passes]) == 2
    assert "Mitsuba is measured in one pass, got --passes 2" in capsys.readouterr().err


def test_visibility(tmp_path, fake_peer):
    small = ["--search", "2", "--differences", "2", "--difference-spp", "4", "--peer", f"mitsuba={sys.executable}"]
    result = run(tmp_path, "visibility", *TINY, *small, "--only", "small lamp")
    efficiency, bias, (passes,), searched = (table["rows"] for table in result["tables"])
    assert passes["with / without"] == passes["with outlines s"]["median"] / passes["without s"]["median"] > 0
    assert [row["program"] for row in efficiency] == ["ours", "Mitsuba", "Mitsuba, defaults"]
    assert efficiency[0]["setting"] == "" and efficiency[0]["time s"]["n"] == 2
    assert 0 < efficiency[0]["time s"]["median"] < 10
    # octrees are fastest, and the more indirect samples the better; nothing is seen directly
    assert efficiency[1]["setting"] == "direct_projective, octree 64, 2/0/32"
    assert efficiency[2]["setting"] == "direct_projective, octree 512, 2/2/2"
    assert efficiency[1]["efficiency"] == pytest.approx(1 / (0.005 * 0.25 / 32))
    assert efficiency[2]["efficiency"] == pytest.approx(1 / (0.005 * 0.25 / 2))
    assert [row["derivative"] for row in bias[1:]] == pytest.approx([1.05, 1.05])
    # what takes Mitsuba's place is far off
    assert all(row["our efficiency / its"] is None and row["to an error of 5 % s"] is None for row in efficiency[1:])
    for row in bias:
        error = (row["error"] ** 2 + row["error of these"] ** 2) ** 0.5
        assert row["z"] == pytest.approx((row["derivative"] - row["differences"]) / error)
    assert len(searched) == 2 * 3 + 4
    (table, *_) = result["tables"]
    assert sum("no grid of" in note for note in table["notes"]) == 4


def test_visibility_that_peers_do_not_have(tmp_path, fake_peer):
    small = ["--quick", "--difference-spp", "4", "--peer", f"mitsuba={sys.executable}"]
    result = run(tmp_path, "visibility", *TINY, *small, "--only", "point light")
    efficiency, bias, passes = result["tables"]
    assert [row["program"] for table in (efficiency, bias, passes) for row in table["rows"]] == ["ours"] * 3
    assert any("not in Mitsuba: the boundary terms" in note for note in efficiency["notes"])
    assert result["settings"]["resolution"] == 64 and efficiency["rows"][0]["time s"]["n"] == 4
    with pytest.raises(SystemExit, match="no scene's name contains 'teapot'"):
        main(["visibility", *TINY, "--only", "teapot"])


def test_rays(tmp_path):
    rows = run(tmp_path, "rays", *TINY, "--only", "Cornell")["tables"][0]["rows"]
    assert [row["rays"] for row in rows] == ["camera", "bounce", "camera shadow", "bounce shadow"]
    assert rows[0]["number M"] == pytest.approx(16 * 16 * 2 / 1e6)
    for row in rows:
        assert 0 < row["hits %"] < 100
        assert row["best Mrays/s"] == pytest.approx(1e3 / row[f"{row['best']} ns"]["median"])


def test_gradient_index(tmp_path, forks):
    options = [
        "--resolution",
        "8",
        "--spp",
        "2",
        "--rounds",
        "1",
        "--warmup",
        "0",
        "--threads",
        "1",
        "--size",
        "12",
        "--spp-grad",
        "1",
        "--passes",
        "2",
        "--quick",
    ]
    tables = run(tmp_path, "gradient_index", *options)["tables"]
    assert "2 views of 8x8, 2 x (2 + 1) samples" in tables[2]["title"]
    assert [table["part"] for table in tables] == ["step", "iteration", "light", "memory", "autograd", "error"]
    step, iteration, light, memory, autograd, error = (table["rows"] for table in tables)
    for row in step:
        assert 12 <= row["steps a ray"] < 16  # the index is never less than 1.45, of 1.5625 that steps are made for
        assert 0 < row["forward, a step and core, ns"]["median"] < row["with adjoint, a step and core, ns"]["median"]
        assert 0 < row["forward, whole call, s"]["median"] < row["with adjoint, whole calls, s"]["median"] < 10
    for row in iteration + light:
        assert 0 < row["one iteration s"]["median"] < 10 and row["peak above the state before MiB"]["median"] < 100
    assert light[0]["gradient, norm"] == pytest.approx(light[1]["gradient, norm"], rel=0.3)
    assert memory[1]["steps a ray"] == pytest.approx(10 * memory[0]["steps a ray"], rel=0.02)
    ours, plain = autograd
    assert plain["gradient, norm"] == pytest.approx(ours["gradient, norm"], rel=1e-4)
    assert plain["memory / ours"] > ours["memory / ours"] == ours["time / ours"] == 1
    for name in ("cubic", "quadratic"):
        found = [row["position, rms, voxels"] for row in error if row["interpolation"] == name]
        assert 0 < found[2] < found[1] / 2 < found[0] / 4
    with pytest.raises(SystemExit, match="--only and --set have no meaning"):
        main(["gradient_index", "--quick", "--only", "sphere"])


@pytest.mark.parametrize("interpolation", ["cubic", "quadratic"])
def test_rays_in_pytorch_are_those_of_the_core(interpolation):
    import torch

    import torchrender as tr
    from bench import bent_rays

    index = bent_rays.index_of(12).double()
    origins, directions = (x.double() for x in bent_rays.beam(4, 2))
    ours = tr.gradientindex.trace(
        bent_rays.cube(index, torch.float64, interpolation=interpolation), "cube", origins, directions
    )
    position, direction, steps = bent_rays.in_torch(index, origins, directions, interpolation=interpolation)
    assert bool(ours.valid.all()) and steps == int(ours.steps.max())
    assert torch.allclose(position, ours.position, atol=1e-8) and torch.allclose(direction, ours.direction, atol=1e-8)
