from __future__ import annotations

import csv
import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import cv2
import pytest
import torch
import yaml

from revnm_server.networks.bundle import default_bundle_path, load_bundle
from revnm_training.checkpoint import load_checkpoint
from revnm_training.cli import main
from revnm_training.preset import load_preset

pytestmark = pytest.mark.slow

ONE_WIDTH = {"width": 8, "blocks": [1, 1]}


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module", params=["picture", "edge"])
def home(request, tmp_path_factory) -> Path:
    """A folder with a preset made tiny and a few labelled episodes."""
    folder = tmp_path_factory.mktemp("training")
    shipped = resources.files("revnm_training") / "presets" / f"{request.param}.yaml"
    preset = yaml.safe_load(shipped.read_text(encoding="utf-8"))
    preset["name"] = "tiny"
    preset["observation"] |= {"exo_hw": [24, 32], "crop_px": 32}
    if request.param == "picture":
        preset["observation"]["disparity_hw"] = [48, 64]
        preset["policy"]["exo_backbone"] = ONE_WIDTH
    policy = preset["policy"] or preset["map_policy"]
    policy |= {"ego_backbone": ONE_WIDTH, "width": 16, "heads": 2, "feedforward": 16}
    policy |= {"vae_layers": 1, "encoder_layers": 1, "decoder_layers": 1}
    if preset["map_policy"]:
        policy["backbone"] = {"width": 8, "blocks": [1, 1, 1]}
    preset["exo2ego"] |= {"width": 16, "depth": 1, "heads": 2}
    preset["depth"]["backbone"] = ONE_WIDTH
    for recipe in ("train_policy", "train_exo2ego", "train_depth"):
        preset[recipe] |= {"batch": 16, "warmup_steps": 2, "learning_rate": 0.002, "ema": 0.9}
    (folder / "tiny.yaml").write_text(yaml.safe_dump(preset), encoding="utf-8")
    arguments = ["--episodes", "8", "--goals", "2", "--states", "8", "--out", str(folder / "data")]
    assert main(["synth", "--preset", str(folder / "tiny.yaml"), "--jobs", "1", *arguments]) == 0
    return folder


def train(home: Path, kind: str, cache: str, *options: str) -> int:
    common = ["--preset", str(home / "tiny.yaml"), "--jobs", "1", "--out", str(home / kind)]
    return main([kind, *common, "--cache", str(home / cache), *options])


def losses(folder: Path, name: str = "loss") -> list[float]:
    with (folder / "training.csv").open(encoding="utf-8") as file:
        return [float(row[name]) for row in csv.DictReader(file)]


def test_exo2ego_then_policy_learn_from_episodes(home, capsys) -> None:
    data = ("--data", str(home / "data"), "--steps", "120")
    sees_map = load_preset(str(home / "tiny.yaml")).map_policy is not None
    assert train(home, "exo2ego", "cache", *data) == 0
    first, *_, last = losses(home / "exo2ego")
    assert last < 0.7 * first
    record = load_checkpoint(home / "exo2ego" / "last.pt", "exo2ego").record
    steps = {1, 8} if sees_map else {1, 2, 8}
    assert set(record["validation"]) == {f"psnr_{count}_steps_db" for count in steps}

    checkpoint = ("--exo2ego", str(home / "exo2ego" / "last.pt"))
    assert train(home, "policy", "cache", *data, *checkpoint) == 0
    first, *_, last = losses(home / "policy", "occupied" if sees_map else "loss")
    assert last < 0.85 * first
    record = load_checkpoint(home / "policy" / "last.pt", "policy").record
    measured = {"l1_m", "waypoint_5_m", "first_deg", "last_deg"}
    if sees_map:
        measured |= {"way_l1_m", "hidden_nats", "seen_nats", "seen_map_nats", "cost_error"}
    assert measured <= set(record["validation"])
    assert record["data"]["imagined_ego_share"] == 0.75
    assert list((home / "cache").glob("imagined_*.npy"))
    drawn = cv2.imread(str(home / "policy" / "loss.png"))
    assert drawn is not None
    assert drawn.std() > 5.0

    assert train(home, "policy", "cache", *data) == 2  # a finished run is not overwritten
    assert "a run is there already" in capsys.readouterr().err


def test_dagger_learns_from_its_own_drives(home, capsys) -> None:
    if load_preset(str(home / "tiny.yaml")).map_policy is None:
        pytest.skip("the tiny picture preset has no depth network of its size at hand")
    data = ("--data", str(home / "data"), "--cache", str(home / "cache"), "--steps", "3")
    tiny = ("--preset", str(home / "tiny.yaml"), "--jobs", "1")
    assert main(["exo2ego", *tiny, *data, "--out", str(home / "short_exo2ego")]) == 0
    exo2ego = ("--exo2ego", str(home / "short_exo2ego" / "last.pt"))
    assert main(["policy", *tiny, *data, *exo2ego, "--out", str(home / "short_policy")]) == 0

    out = home / "dagger"
    policy = ("--policy", str(home / "short_policy" / "last.pt"), "--base", str(default_bundle_path()))
    some = ("--rounds", "1", "--rollouts", "1", "--states", "8", "--seed", "900", "--out", str(out))
    assert main(["dagger", *tiny, *data, *exo2ego, *policy, *some]) == 0
    with (out / "rounds.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["label"] for row in rows] == ["round 0", "round 1"]
    assert all(int(row["trials"]) == 1 and 2 <= int(row["labelled_states"]) <= 8 for row in rows)
    run = load_checkpoint(out / "round_1" / "policy" / "last.pt", "policy")
    before = load_checkpoint(home / "short_policy" / "last.pt", "policy")
    assert run.record["data"]["worlds"] > before.record["data"]["worlds"]
    assert load_bundle(out / "round_1" / "bundle").sees == "map"
    assert (out / "success.png").stat().st_size > 1000


def test_depth_learns_from_pictures(home) -> None:
    if load_preset(str(home / "tiny.yaml")).map_policy is not None:
        pytest.skip("the depth network does not depend on what the policy sees")
    assert train(home, "depth", "pictures", "--pictures", "40", "--steps", "60") == 0
    first, *_, last = losses(home / "depth")
    assert last < 0.9 * first
    assert load_checkpoint(home / "depth" / "last.pt", "depth").preset == "tiny"


def test_mistakes_are_told_without_a_traceback(home, capsys) -> None:
    assert train(home, "exo2ego", "cache2", "--resume", "--data", str(home), "--steps", "120") == 2
    assert "no episodes" in capsys.readouterr().err
    missing = ("--data", str(home / "data"), "--steps", "120", "--exo2ego", str(home / "none.pt"))
    assert train(home, "policy", "cache", "--resume", *missing) == 2
    assert "none.pt" in capsys.readouterr().err


def test_two_processes_share_a_run(home) -> None:
    if load_preset(str(home / "tiny.yaml")).map_policy is None:
        pytest.skip("one preset shows it")
    arguments = ["--data", str(home / "data"), "--cache", str(home / "cache"), "--out", str(home / "shared")]
    run = [str(Path(sys.executable).with_name("revnm-train")), "exo2ego", "--preset", str(home / "tiny.yaml")]
    run += [*arguments, "--steps", "4", "--devices", "2"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(run, check=True, timeout=120, env=environment, capture_output=True, text=True)
    assert done.stdout.count("step 4: ") == done.stdout.count(f"done: {home / 'shared'}\n") == 1
    assert load_checkpoint(home / "shared" / "last.pt", "exo2ego").record["samples"] == 4 * 16


@pytest.fixture
def fresh(home, tmp_path) -> list[str]:
    """Options of a run that would make a new cache and a new folder."""
    return ["--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "out"), "--steps", "2", "--jobs", "1"]


def refused(arguments: list[str], tmp_path: Path, capsys) -> str:
    """Run a command that fails before it makes anything; return what it says."""
    assert main(arguments) == 2
    assert not (tmp_path / "cache").exists()
    assert not (tmp_path / "out").exists()
    return capsys.readouterr().err


def test_a_damaged_episode_file_is_refused(home, tmp_path, fresh, capsys) -> None:
    whole = next((home / "data").glob("*.parquet")).read_bytes()
    (tmp_path / "data").mkdir()
    path = tmp_path / "data" / "episodes_000_0000000.parquet"
    run = ["exo2ego", "--preset", str(home / "tiny.yaml"), "--data", str(path.parent), *fresh]
    for content in (whole[: len(whole) // 2], b"", whole[:-1]):
        path.write_bytes(content)
        assert f"{path}: no readable parquet file, perhaps truncated" in refused(run, tmp_path, capsys)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda preset: preset["exo2ego"].update(depht=3), "depht"),
        (lambda preset: preset["exo2ego"].pop("steps"), "steps"),
        (lambda preset: preset["train_exo2ego"].update(batch="many"), "batch"),
    ],
)
def test_a_malformed_preset_is_refused(home, tmp_path, fresh, capsys, change, told) -> None:
    preset = yaml.safe_load((home / "tiny.yaml").read_text(encoding="utf-8"))
    change(preset)
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(preset), encoding="utf-8")
    run = ["exo2ego", "--preset", str(tmp_path / "site.yaml"), "--data", str(home / "data"), *fresh]
    said = refused(run, tmp_path, capsys)
    assert str(tmp_path / "site.yaml") in said
    assert told in said


def test_a_checkpoint_of_another_preset_is_refused(home, tmp_path, fresh, capsys) -> None:
    data = ("--data", str(home / "data"), "--steps", "2", "--out", str(home / "of_tiny"))
    assert main(["exo2ego", "--preset", str(home / "tiny.yaml"), "--cache", str(home / "cache"), *data]) == 0
    checkpoint = home / "of_tiny" / "last.pt"
    other = (home / "tiny.yaml").read_text(encoding="utf-8").replace("name: tiny", "name: other")
    (tmp_path / "other.yaml").write_text(other, encoding="utf-8")
    preset = ["--preset", str(tmp_path / "other.yaml"), "--data", str(home / "data")]

    said = refused(["policy", *preset, *fresh, "--exo2ego", str(checkpoint)], tmp_path, capsys)
    assert f"{checkpoint}: trained with preset 'tiny', not 'other'" in said
    resumed = ["exo2ego", *preset, *fresh, "--out", str(home / "of_tiny"), "--resume"]
    assert f"{checkpoint}: preset tiny, but asked for other" in refused(resumed, tmp_path, capsys)
    export = ["export", "--preset", str(tmp_path / "other.yaml"), "--exo2ego", str(checkpoint)]
    export += ["--base", str(default_bundle_path()), "--out", str(tmp_path / "out")]
    assert "trained with preset 'tiny', not 'other'" in refused(export, tmp_path, capsys)
