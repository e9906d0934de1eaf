from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm
from tests.server.tiny_bundle import write_tiny_bundle

from revnm_client.errors import FileError
from revnm_client.geometry import Pose2
from revnm_server.networks.bundle import load_bundle
from revnm_sim.generation.generator import is_training_seed, random_pillar
from revnm_sim.occupancy import occupancy
from revnm_sim.rays.raycast import cast_depth, cast_scan, ego_camera
from revnm_sim.world import primitive_arrays
from revnm_training.cli import main
from revnm_training.depth_metrics import depth_errors
from revnm_training.preset import load_preset
from revnm_training.quality.command import measure
from revnm_training.quality.encoder import DepthEncoder, encoder_path
from revnm_training.quality.encoder_training import EncoderNetwork, EncoderTask, FeatureGraph
from revnm_training.quality.metrics import (
    false_free,
    frechet_distance,
    kernel_distance,
    mean_ssim,
    psnr_db,
    sector_error_m,
)
from revnm_training.quality.sectors import metres, sector_distances
from revnm_training.quality.views import evaluation_seed, make_views

SPEC = load_preset("edge").observation  # 32 × 32, 120°, 0.25 m high, 6 m
FOCAL_PX = 16.0 / math.tan(math.radians(60.0))
OFFSET = (np.arange(32) - 15.5) / FOCAL_PX  # of a pixel's middle at depth 1, to the right or down


def bare_floor() -> np.ndarray:
    """A floor without end, clipped at 6 m: 0.25 m under the camera."""
    rows = np.full(32, 6.0)
    rows[16:] = np.minimum(0.25 / OFFSET[16:], 6.0)
    return np.tile(rows[:, None], (1, 32))[None]


def test_psnr_is_the_mean_of_the_images_and_pooled() -> None:
    true = np.zeros((2, 8, 8))
    imagined = np.stack([np.full((8, 8), 0.1), np.full((8, 8), 0.01)])
    # MSE 1e-2 and 1e-4: 20 and 40 dB; together 0.00505: 22.967 dB.
    assert psnr_db(true, imagined) == pytest.approx((30.0, -10.0 * math.log10(0.00505)))
    assert psnr_db(true, true) == pytest.approx((90.0, 90.0))


def test_ssim_of_an_image_with_itself_is_one() -> None:
    images = np.random.default_rng(0).random((3, 32, 32))
    assert mean_ssim(images, images) == pytest.approx(1.0)
    # Two flat images: (2 a b + C1) / (a² + b² + C1), C1 = 0.01².
    assert mean_ssim(np.full((1, 32, 32), 0.2), np.full((1, 32, 32), 0.4)) == pytest.approx(0.1601 / 0.2001)


def test_frechet_distance_of_gaussians() -> None:
    # Four points have mean 0 and, with M − 1 = 3, variances 2 a² / 3 and 2 b² / 3, without covariance.
    cross = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    one, other = cross * [3.0, 1.0], cross * [1.0, 2.0] + [5.0, 7.0]
    # |(5, 7)|² + 2/3 ((3 − 1)² + (1 − 2)²)
    assert frechet_distance(one, other) == pytest.approx(74.0 + 10.0 / 3.0)
    assert frechet_distance(one, one) == pytest.approx(0.0, abs=1e-9)
    # Nothing varies in the other: only the trace of the first is left.
    assert frechet_distance(one, np.zeros((4, 2))) == pytest.approx(2.0 / 3.0 * 10.0)


def test_frechet_distance_of_covariances_that_do_not_commute() -> None:
    rng = np.random.default_rng(2)
    one, other = rng.standard_normal((50, 4)) @ rng.standard_normal((4, 4)), rng.standard_normal((60, 4))
    a, b = np.cov(one, rowvar=False), np.cov(other, rowvar=False)
    offset = one.mean(axis=0) - other.mean(axis=0)
    expected = offset @ offset + np.trace(a + b - 2.0 * np.real(sqrtm(a @ b)))
    assert frechet_distance(one, other) == pytest.approx(expected)


def test_kernel_distance_by_hand() -> None:
    # d = 1, kernel (x y + 1)³: among (0, 1) 1, among (1, 1) 8, between them 1, 1, 8, 8: 1 + 8 − 2 · 4.5.
    assert kernel_distance(np.array([[0.0], [1.0]]), np.array([[1.0], [1.0]])) == pytest.approx(0.0)
    # Among (0, 0) 1, among (2, 2) 125, between them 1: 1 + 125 − 2.
    assert kernel_distance(np.zeros((2, 1)), np.full((2, 1), 2.0)) == pytest.approx(124.0)


def test_kernel_distance_tells_distributions_apart() -> None:
    rng = np.random.default_rng(1)
    draws = rng.standard_normal((3, 2000, 8))
    same, shifted = kernel_distance(draws[0], draws[1]), kernel_distance(draws[0], draws[2] + 0.5)
    assert abs(same) < 0.02
    assert shifted > 10 * abs(same)
    assert shifted > 0.1


def test_bare_floor_is_free() -> None:
    np.testing.assert_array_equal(sector_distances(bare_floor(), SPEC), np.full((1, 16), 6.0))


def test_a_flat_wall_is_nearest_straight_ahead() -> None:
    distances = sector_distances(np.minimum(bare_floor(), 2.0), SPEC)[0]
    # The pixel of a sector that is nearest to the middle decides; its range is 2 m times the root of 1 + x².
    columns = [15, 14, 13, 11, 10, 8, 6, 3]  # outwards: 3.1°, 9.2°, 15.1°, 26.0°, 30.8°, 39.1°, 45.8°, 53.5°
    expected = 2.0 * np.hypot(1.0, OFFSET[columns])
    np.testing.assert_allclose(distances[7::-1], expected)
    np.testing.assert_allclose(distances[8:], expected)


def test_a_pillar_stands_in_its_sector_only() -> None:
    depth = bare_floor()
    depth[:, 5:22, 18] = 1.2  # 15.1° to the right; its foot is in row 20, where the floor is 0.51 m away
    depth[0, 20:, 18] = bare_floor()[0, 20:, 18]
    depth[0, :9, 18] = 6.0
    distances = sector_distances(depth, SPEC)[0]
    assert distances[10] == pytest.approx(1.2 * math.hypot(1.0, 2.5 / FOCAL_PX))  # 15° to 22.5°
    assert (np.delete(distances, 10) == 6.0).all()


def test_a_doorstep_is_floor_and_a_rack_is_driven_under() -> None:
    step = bare_floor()
    step[:, 16:] *= 0.85  # 0.04 m high everywhere
    assert (sector_distances(step, SPEC) == 6.0).all()
    rack = bare_floor()
    rack[:, :15] = 3.0  # row 14 shows it 0.74 m high
    assert (sector_distances(rack, SPEC) == 6.0).all()
    rack[:, 15] = 3.0  # and this row 0.41 m
    assert sector_distances(rack, SPEC).min() == pytest.approx(3.0 * math.hypot(1.0, OFFSET[15]))


def test_sectors_of_true_depth_are_what_a_laser_measures() -> None:
    world = random_pillar(5)
    grid, arrays = occupancy(world), primitive_arrays(world.primitives)
    rng = np.random.default_rng(0)
    places = rng.uniform(-4.0, 4.0, (100, 2))
    for x, y in places[grid.clearance_m(places) > 0.22][:30]:
        pose = Pose2(x, y, rng.uniform(-math.pi, math.pi))
        depth = cast_depth(arrays, ego_camera(pose, SPEC), (32, 32)).astype(np.float64)
        seen = sector_distances(np.minimum(depth, 6.0)[None], SPEC)[0]
        angles = -np.arctan(OFFSET)
        scan = cast_scan(arrays, pose, height_m=0.2, angles_rad=angles, max_range_m=6.0)
        sector = np.floor((np.degrees(-angles) + 60.0) / 7.5).astype(int)
        expected = [min(6.0, *scan[sector == number]) for number in range(16)]
        np.testing.assert_allclose(seen, expected, atol=0.02)


def test_false_free_counts_near_obstacles_that_are_overlooked() -> None:
    true = np.full((1, 16), 3.0)
    true[0, :4] = [0.3, 0.59, 0.5, 0.6]  # the last is not under 0.6 m
    imagined = np.full((1, 16), 3.0)
    imagined[0, :3] = [1.01, 1.0, 0.2]  # the second is not over 1.0 m
    assert false_free(true, imagined) == (pytest.approx(1.0 / 3.0), 3)
    assert false_free(np.full((1, 16), 3.0), imagined) == (None, 0)
    # |0.71| + |0.41| + |−0.3| + |2.4|
    assert sector_error_m(true, imagined) == pytest.approx(3.82 / 16.0)


def test_perfect_imagination_measures_perfect() -> None:
    ego = random_views(40)
    measured = measure(ego, ego, SPEC, DepthEncoder(encoder_path()))
    assert measured["psnr_db"] == measured["psnr_pooled_db"] == 90.0
    assert measured["ssim"] == 1.0
    assert measured["fdd"] == pytest.approx(0.0, abs=1e-3)
    assert measured["sector_error_m"] == measured["false_free_rate"] == 0.0
    blank = measure(ego, np.ones_like(ego), SPEC, DepthEncoder(encoder_path()))
    assert blank["fdd"] > 1.0
    assert blank["false_free_rate"] == 1.0
    free_m = sector_distances(metres(ego, SPEC), SPEC)
    assert blank["sector_error_m"] == pytest.approx((6.0 - free_m).mean(), abs=1e-3)
    assert blank["near_sectors"] == (free_m < 0.6).sum() > 0


def random_views(count: int) -> np.ndarray:
    """Ego depth of views in an evaluation world, as exo2ego would give it."""
    made = make_views("random_pillar", replace(SPEC, disparity_hw=(48, 64)), count=count, seed=1, jobs=1)
    return np.stack([view.ego for view in made])


def test_worlds_are_evaluation_worlds() -> None:
    seeds = [evaluation_seed(np.random.SeedSequence([1000, number, 0])) for number in range(200)]
    assert not any(is_training_seed(seed) for seed in seeds)
    assert len(set(seeds)) == 200


def test_views_have_the_shapes_of_the_observation_and_are_repeatable() -> None:
    spec = replace(SPEC, history=2, disparity_hw=(48, 64))
    one = make_views("random_pillar", spec, count=30, seed=7, jobs=1)
    assert len(one) == 30
    other = make_views("random_pillar", spec, count=30, seed=7, jobs=1)
    for a, b in zip(one, other, strict=True):
        assert a.crops.shape == (2, 64, 64)
        assert a.ego.shape == (32, 32)
        assert ((a.pose.p_rob > 0.0) & (a.pose.p_rob < 1.0)).all()
        np.testing.assert_array_equal(a.crops, b.crops)
        np.testing.assert_array_equal(a.ego, b.ego)


def test_an_altered_encoder_is_refused(tmp_path) -> None:
    path = tmp_path / "depth_encoder.onnx"
    with pytest.raises(FileError, match="missing"):
        DepthEncoder(path)
    content = bytearray(encoder_path().read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(FileError, match="altered: sha256 expected"):
        DepthEncoder(path)


def test_features_have_unit_scale_on_true_depth() -> None:
    features = DepthEncoder(encoder_path()).features(random_views(200))
    assert features.shape == (200, 128)
    assert np.abs(features.mean(axis=0)).mean() < 0.5
    assert 0.5 < features.std(axis=0).mean() < 1.5


def test_the_encoder_learns_sectors() -> None:
    torch.manual_seed(0)
    ego = random_views(64)
    task, network = EncoderTask(ego, 16, SPEC), EncoderNetwork()
    assert task.train_size == 48
    batch = task.batch(np.arange(48), np.random.default_rng(0))
    np.testing.assert_allclose(batch["free"].numpy() * 6.0, sector_distances(metres(ego[:48], SPEC), SPEC), rtol=1e-6)
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    generator = torch.Generator()
    losses = []
    for _ in range(60):
        optimiser.zero_grad()
        loss = task.loss(network, batch, generator)["loss"]
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.4 * losses[0]
    assert FeatureGraph(network.eval())(batch["depth"]).shape == (48, 128)
    with torch.no_grad():
        held_out = task.validate(network, torch.device("cpu"))["sector_error_m"]
    blank_m = float((6.0 - sector_distances(metres(ego[48:], SPEC), SPEC)).mean())
    assert 0.0 < held_out < blank_m


def test_the_command_measures_a_bundle_and_goes_on(tmp_path, capsys) -> None:
    bundle, out = write_tiny_bundle(tmp_path / "tiny"), tmp_path / "out"
    arguments = ["quality", "--bundle", str(bundle), "--images", "64", "--jobs", "1", "--seed", "3", "--pictures", "0"]
    worlds = ["--world", "random_pillar,demo_room"]
    assert main([*arguments, *worlds, "--out", str(out)]) == 0
    assert "| exo2ego" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert set(report) == {"rows", "command", "versions", "machine"}
    rows = report["rows"]
    assert [(row["world"], row["source"]) for row in rows] == [
        ("random_pillar", "exo2ego"),
        ("random_pillar", "blank"),
        ("demo_room", "exo2ego"),
        ("demo_room", "blank"),
    ]
    assert all(row["images"] == 64 and row["steps"] == 2 for row in rows)
    assert rows[1]["false_free_rate"] == 1.0

    # The tiny bundle imagines the crop, 2 disparity − 1: its PSNR follows from the views themselves.
    spec = load_bundle(bundle).spec
    made = make_views("random_pillar", spec, count=64, seed=3, jobs=1)
    mse = [np.mean((view.crops[-1] - (view.ego + 1.0) / 2.0) ** 2) for view in made]
    assert rows[0]["psnr_db"] == pytest.approx(np.mean(-10.0 * np.log10(mse)), abs=0.006)

    (out / "views_demo_room.npz").unlink()
    (out / "report.json").unlink()
    kept = (out / "views_random_pillar.npz").stat().st_mtime_ns
    assert main([*arguments, *worlds, "--out", str(out)]) == 0
    assert json.loads((out / "report.json").read_text())["rows"] == rows
    assert (out / "views_random_pillar.npz").stat().st_mtime_ns == kept


def test_the_prior_of_a_view_shows_where_the_floor_ends(tmp_path) -> None:
    spec = load_bundle(write_tiny_bundle(tmp_path / "tiny", sees="map")).spec
    spec = replace(spec, disparity_hw=(96, 128))
    made = make_views("random_pillar", spec, count=40, seed=3, jobs=1, prior=True)
    apart, blank, known = [], [], []
    for view in made:
        assert view.prior is not None
        depth, seen = view.prior
        sure = seen > 0.5
        known.append(sure.mean())
        apart.append(np.abs(depth - view.ego)[sure].mean())
        blank.append(np.abs(1.0 - view.ego)[sure].mean())
    assert np.mean(known) > 0.3
    assert np.mean(apart) < 0.5 * np.mean(blank)
    assert make_views("random_pillar", spec, count=2, seed=3, jobs=1)[0].prior is None


def test_the_command_measures_a_bundle_whose_exo2ego_has_a_prior(tmp_path) -> None:
    bundle, out = write_tiny_bundle(tmp_path / "tiny", sees="map"), tmp_path / "out"
    arguments = ["quality", "--bundle", str(bundle), "--world", "demo_room", "--images", "26", "--pictures", "6"]
    assert main([*arguments, "--jobs", "1", "--out", str(out)]) == 0
    rows = json.loads((out / "report.json").read_text())["rows"]
    assert [row["source"] for row in rows] == ["exo2ego", "blank", "depth"]
    # Its depth network takes brightness for disparity: it is wrong, and not absurdly so.
    assert 0.05 < rows[2]["abs_rel"] < 2.0
    assert 0.02 < rows[2]["delta1"] < 0.95
    assert rows[2]["pictures"] == 6


def test_depth_errors_ignore_scale_and_shift() -> None:
    true = 1.0 / np.random.default_rng(0).uniform(1.0, 9.0, (20, 30))
    errors = depth_errors(5.0 * true - 0.4, true)
    assert errors.abs_rel == pytest.approx(0.0, abs=1e-9)
    assert errors.delta1 == 1.0
    assert depth_errors(np.random.default_rng(1).random((20, 30)), true).abs_rel > 0.2


def test_depth_errors_of_a_known_mistake() -> None:
    # One disparity for all: the fit is the mean, 0.35, so depths 2 m and 5 m are both taken for 2.86 m.
    true = np.array([[0.5, 0.2], [0.5, 0.2]])
    errors = depth_errors(np.ones((2, 2)), true)
    mean = 0.35
    assert errors.abs_rel == pytest.approx(np.mean([0.5 / mean - 1.0, 1.0 - 0.2 / mean]))
    assert errors.delta1 == 0.0


def test_mistakes_of_quality_are_told(tmp_path, capsys) -> None:
    bundle, out = write_tiny_bundle(tmp_path / "tiny"), tmp_path / "out"
    out.mkdir()

    def fails(*options: str) -> str:
        assert main(["quality", "--bundle", str(bundle), "--jobs", "1", "--out", str(out), *options]) == 2
        return capsys.readouterr().err

    assert "no world is named 'moon'" in fails("--world", "moon")
    assert "--images 1" in fails("--images", "1")
    assert "--steps 1001: expected 1 to 1000" in fails("--steps", "1001")
    assert "--steps 0: expected" in fails("--steps", "0")
    assert "same name" in fails("--world", "a/shop.yaml,b/shop.yaml")
    (out / "views_demo_room.npz").write_bytes(b"PK")
    assert "no readable views" in fails("--world", "demo_room", "--images", "8")
    (out / "views_demo_room.npz").unlink()
    one_world = ["--world", "demo_room", "--images", "8", "--pictures", "0", "--jobs", "1"]
    assert main(["quality", "--bundle", str(bundle), *one_world, "--out", str(out)]) == 0
    assert "another bundle" in fails("--world", "demo_room", "--images", "8", "--seed", "2")
