from __future__ import annotations

import csv
from importlib import resources
from pathlib import Path

import pytest
import torch
import yaml

from revnm_training.checkpoint import load_checkpoint
from revnm_training.cli import main
from revnm_training.preset import load_preset

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
    assert measured | ({"way_l1_m", "hidden_nats", "cost_error"} if sees_map else set()) <= set(record["validation"])
    assert record["data"]["imagined_ego_share"] == 0.75
    assert list((home / "cache").glob("imagined_*.npy"))

    assert train(home, "policy", "cache", *data) == 1  # a finished run is not overwritten
    assert "a run is there already" in capsys.readouterr().err


def test_depth_learns_from_pictures(home) -> None:
    if load_preset(str(home / "tiny.yaml")).map_policy is not None:
        pytest.skip("the depth network does not depend on what the policy sees")
    assert train(home, "depth", "pictures", "--pictures", "40", "--steps", "60") == 0
    first, *_, last = losses(home / "depth")
    assert last < 0.9 * first
    assert load_checkpoint(home / "depth" / "last.pt", "depth").preset == "tiny"


def test_mistakes_are_told_without_a_traceback(home, capsys) -> None:
    assert train(home, "exo2ego", "cache2", "--data", str(home), "--steps", "1") == 1
    assert "no episodes" in capsys.readouterr().err
    missing = ("--data", str(home / "data"), "--steps", "1", "--exo2ego", str(home / "none.pt"))
    assert train(home, "policy", "cache", "--resume", *missing) == 1
    assert "none.pt" in capsys.readouterr().err
