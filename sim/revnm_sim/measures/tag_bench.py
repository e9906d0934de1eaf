"""Measures how small a tag the server's libraries find, how exactly, how fast, and what they take for a tag.

Pictures are small, where nothing else is said: libraries look at a tag's surroundings only, so that larger ones would
show no more. Times are of the processor and one thread, so that what else a machine does hardly moves them.
"""

from __future__ import annotations

import itertools
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from tqdm import tqdm

from revnm_client.geometry import FloatArray
from revnm_server.tag.library import Detection, Gray, Region, TagLibrary, whole_picture
from revnm_server.tag.regions import WORK_PX, Look, looks, region_around
from revnm_sim.measures.tag_clutter import TAG_FREE
from revnm_sim.measures.tag_scene import DIFFICULTIES, Difficulty, TagScene, tag_scene, taken
from revnm_sim.tag_picture import TagPicture

SIDES_PX = (8, 10, 12, 14, 16, 20, 24, 30, 40)
SIZES_PX = ((640, 480), (1920, 1080))
_FOLLOWED_PX = (14, 20, 40, 120)  # sides of tags

_TAG_ID = 3
_AROUND_TAG_PX = (208, 160)  # pictures with a tag
_TAG_FREE_PX = (320, 240)
_MARGIN_SIDES = 0.55  # around a tag, as it is at ten pictures a second
_STEP_SIDES = 0.2  # how far a tag moves from picture to picture, at most, in its sides
_NEAR_PX = 3.0  # a detection farther off has found something else
_WORLDS_EVERY = 20  # drawing one takes ten times as long as any other picture
_SEARCHES = {"search_half": 2.0, "search_full": 1.0}


@dataclass(slots=True)
class _Found:
    """What one way of looking gave over many pictures: whether the tag was found, and its corners' errors."""

    hits: list[bool] = field(default_factory=list)
    errors_px: list[float] = field(default_factory=list)

    def add(self, detections: Sequence[Detection], scene: TagScene) -> bool:
        errors = [np.linalg.norm(each.corners - scene.corners, axis=1) for each in detections if each.tag_id == _TAG_ID]
        near = [each for each in errors if each.max() < _NEAR_PX]
        self.hits.append(bool(near))
        self.errors_px += [float(error) for error in near[0]] if near else []
        return self.hits[-1]


def detection_rows(
    libraries: Sequence[TagLibrary], *, trials: int, seed: int, sides_px: Sequence[int] = SIDES_PX
) -> Iterator[dict[str, Any]]:
    """Yield how often a tag of each size is found, and how exactly, a row per difficulty, size, library and way.

    ``search_half``, ``search_full`` and ``search_enlarged`` are the three kinds of search, one picture each;
    ``first_sighting`` is whether one of the three saw it, and ``follow`` looks around a place where it was.
    """
    tag = TagPicture(_TAG_ID)
    conditions = list(itertools.product(DIFFICULTIES.items(), sides_px))
    for (level, difficulty), side_px in tqdm(conditions, desc="sizes", unit=" conditions"):
        found: dict[tuple[str, str], _Found] = defaultdict(_Found)
        rng = np.random.default_rng([seed, side_px, sorted(DIFFICULTIES).index(level)])
        for _ in range(trials):
            scene = tag_scene(tag, side_px=side_px, size_px=_AROUND_TAG_PX, difficulty=difficulty, rng=rng)
            _look(libraries, scene, difficulty, rng, found)
        for (library, mode), each in found.items():
            yield _detection_row(level, side_px, library, mode, each)


def _look(
    libraries: Sequence[TagLibrary],
    scene: TagScene,
    difficulty: Difficulty,
    rng: np.random.Generator,
    found: dict[tuple[str, str], _Found],
) -> None:
    """Show a scene in every way, each search another picture of it, to all libraries the same ones."""
    pictures = {mode: scene.taken(difficulty, rng) for mode in (*_SEARCHES, "search_enlarged")}
    side_px = float(np.linalg.norm(scene.corners[0] - scene.corners[1]))
    last = scene.corners + rng.uniform(-_STEP_SIDES, _STEP_SIDES, 2) * side_px
    regions = {mode: whole_picture(pictures[mode], decimation=factor) for mode, factor in _SEARCHES.items()}
    regions["search_enlarged"] = _enlarged(pictures["search_enlarged"])
    for library in libraries:
        seen = [found[library.name, mode].add(library.detect(region), scene) for mode, region in regions.items()]
        found[library.name, "first_sighting"].hits.append(any(seen))
        around = region_around(pictures["search_enlarged"], last, margin_sides=_MARGIN_SIDES)
        found[library.name, "follow"].add(library.detect(around), scene)


def _enlarged(gray: Gray) -> Region:
    """Return a whole picture as its strips are looked at."""
    twice = cv2.resize(gray, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    return Region(np.asarray(twice, dtype=np.uint8), 0, 0, 2, 1.0)


def _detection_row(level: str, side_px: int, library: str, mode: str, found: _Found) -> dict[str, Any]:
    p50, p95 = np.percentile(found.errors_px, (50.0, 95.0)).round(3).tolist() if found.errors_px else (None, None)
    return {
        "measure": "detection",
        "difficulty": level,
        "library": library,
        "mode": mode,
        "side_px": side_px,
        "pictures": len(found.hits),
        "detection_rate": round(float(np.mean(found.hits)), 3),
        "p50_corner_error_px": p50,
        "p95_corner_error_px": p95,
    }


def time_rows(libraries: Sequence[TagLibrary], *, pictures: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield what a piece of each kind of search, and following one tag, take in cluttered pictures of medium noise."""
    rng = np.random.default_rng(seed)
    conditions = list(itertools.product(SIZES_PX, _FOLLOWED_PX))
    for size_px, side_px in tqdm(conditions, desc="times", unit=" conditions"):
        scenes = [_shown(size_px, side_px, rng) for _ in range(pictures)]
        ways: dict[str, Callable[[_Shown, int], Region]] = {f"follow_{side_px}_px": _followed}
        if side_px == _FOLLOWED_PX[0]:
            ways |= {f"search_{look.name}": partial(_searched, look=look) for look in looks(size_px, WORK_PX)}
        for library, (way, cut) in itertools.product(libraries, ways.items()):
            times_ms = [_detect_ms(library, cut, shown, number) for number, shown in enumerate(scenes)]
            yield _time_row(size_px, library.name, way, times_ms)


class _Shown(NamedTuple):
    """A picture (H, W), and the corners (4, 2) of the tag in it."""

    gray: Gray
    corners: FloatArray


def _shown(size_px: tuple[int, int], side_px: int, rng: np.random.Generator) -> _Shown:
    difficulty = DIFFICULTIES["medium"]
    scene = tag_scene(TagPicture(_TAG_ID), side_px=side_px, size_px=size_px, difficulty=difficulty, rng=rng)
    return _Shown(scene.taken(difficulty, rng), scene.corners)


def _searched(shown: _Shown, number: int, *, look: Look) -> Region:
    return look.piece(shown.gray, number)


def _followed(shown: _Shown, number: int) -> Region:
    return region_around(shown.gray, shown.corners + float(number % 3) - 1.0, margin_sides=_MARGIN_SIDES)


def _detect_ms(library: TagLibrary, cut: Callable[[_Shown, int], Region], shown: _Shown, number: int) -> float:
    started = time.thread_time()
    library.detect(cut(shown, number))
    return (time.thread_time() - started) * 1e3


def _time_row(size_px: tuple[int, int], library: str, mode: str, times_ms: Sequence[float]) -> dict[str, Any]:
    p50, p95 = np.percentile(times_ms, (50.0, 95.0))
    return {
        "measure": "time",
        "width_px": size_px[0],
        "height_px": size_px[1],
        "library": library,
        "mode": mode,
        "pictures": len(times_ms),
        "p50_cpu_ms": round(float(p50), 2),
        "p95_cpu_ms": round(float(p95), 2),
    }


def wrong_id_rows(libraries: Sequence[TagLibrary], *, pictures: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield how many tags, of all 587, are seen where there is none, a row per kind of picture and library.

    Every picture is looked at as it is and enlarged.
    """
    rng = np.random.default_rng(seed)
    kinds = [kind for kind in TAG_FREE if kind != "worlds"]
    counts: dict[str, int] = defaultdict(int)
    wrong: dict[tuple[str, str], int] = defaultdict(int)
    for number in tqdm(range(pictures), desc="tag-free", unit=" pictures"):
        kind = "worlds" if number % _WORLDS_EVERY == 0 else kinds[number % len(kinds)]
        difficulty = list(DIFFICULTIES.values())[number % len(DIFFICULTIES)]
        gray = taken(TAG_FREE[kind](rng, _TAG_FREE_PX).astype(np.float32), difficulty, rng)
        counts[kind] += 1
        for library in libraries:
            for region in (whole_picture(gray, decimation=1.0), _enlarged(gray)):
                wrong[kind, library.name] += len(library.detect(region))
    for kind, library in itertools.product(counts, libraries):
        yield {
            "measure": "wrong_ids",
            "library": library.name,
            "kind": kind,
            "pictures": counts[kind],
            "wrong_ids": wrong[kind, library.name],
        }
