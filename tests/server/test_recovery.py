"""Records that were cut or damaged: as much as is sound becomes a readable file."""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import FileError
from revnm_server.recording import topics
from revnm_server.recording.record_file import RecordFile
from revnm_server.recording.recovery import recover
from revnm_server.recording.ros import string_message

from .recording_parts import STAMP_NS, read

CHUNKS, PER_CHUNK = 6, 5


def write_record(path: Path, *, finish: bool = True) -> None:
    """Chunks of five messages, each with 1 kB that does not compress."""
    rng = np.random.default_rng(0)
    file = RecordFile(path, about={"format": "test"}, topics=[topics.TICKS, topics.state("rover")])
    for number in range(CHUNKS * PER_CHUNK):
        text = f"{number} {rng.bytes(500).hex()}"
        file.write(
            topics.TICKS if number % 2 else topics.state("rover"), string_message(text), log_ns=STAMP_NS + number
        )
        if number % PER_CHUNK == PER_CHUNK - 1:
            file.flush()
    if finish:
        file.finish()
    else:
        file.abandon()


def numbers(path: Path) -> list[int]:
    """Which messages a file holds."""
    found = [int(message.data.split()[0]) for messages in read(path).values() for message in messages]
    return sorted(found)


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    path = tmp_path / "revnm-20260101-000000-000.mcap"
    write_record(path)
    return path


def test_a_file_that_was_left_is_recovered(tmp_path: Path) -> None:
    path = tmp_path / "revnm-20260101-000000-000.mcap"
    write_record(path, finish=False)
    part = path.with_name(path.name + ".part")
    before = part.read_bytes()
    saved = recover(part)
    assert saved.path == tmp_path / "revnm-20260101-000000-000.recovered.mcap"
    assert (saved.messages, saved.orphans, saved.damaged) == (CHUNKS * PER_CHUNK, 0, 0)
    assert numbers(saved.path) == list(range(CHUNKS * PER_CHUNK))
    assert part.read_bytes() == before
    with pytest.raises(FileError, match="is there already"):
        recover(part)


def test_a_file_that_is_cut_anywhere_gives_its_whole_chunks(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap.part"
    saved = []
    for length in range(0, len(data) + 1000, 1000):
        cut.write_bytes(data[:length])
        try:
            result = recover(cut)
        except FileError as error:
            assert "no message can be read" in str(error)  # noqa: PT017 - either may be
            saved.append(0)
            continue
        assert numbers(result.path) == list(range(result.messages))
        saved.append(result.messages)
        result.path.unlink()
    assert saved == sorted(saved)
    assert saved[0] == 0
    assert saved[-1] == CHUNKS * PER_CHUNK
    assert set(saved) == set(range(0, CHUNKS * PER_CHUNK + 1, PER_CHUNK))


@pytest.mark.parametrize("damage", ["content", "length", "kind"])
def test_a_damaged_chunk_costs_only_itself(whole: Path, damage: str) -> None:
    data = bytearray(whole.read_bytes())
    first = data.index(b"\x04\x00\x00\x00zstd")
    second = data.index(b"\x04\x00\x00\x00zstd", first + 1)
    begins = second - 28 - 9
    if damage == "content":
        data[second + 200] ^= 0xFF
    elif damage == "length":
        data[begins + 4] ^= 0xFF
    else:
        data[begins] = 0x7F
    whole.write_bytes(data)
    saved = recover(whole)
    assert saved.damaged == 1
    lost = range(PER_CHUNK, 2 * PER_CHUNK)
    assert numbers(saved.path) == [n for n in range(CHUNKS * PER_CHUNK) if n not in lost]


def test_a_damaged_first_chunk_takes_its_channels_from_the_end(whole: Path) -> None:
    data = bytearray(whole.read_bytes())
    data[data.index(b"\x04\x00\x00\x00zstd") + 200] ^= 0xFF
    whole.write_bytes(data)
    assert numbers(recover(whole).path) == list(range(PER_CHUNK, CHUNKS * PER_CHUNK))


def test_without_channels_messages_are_counted_as_orphans(whole: Path) -> None:
    data = bytearray(whole.read_bytes())
    marks = [match.start() for match in re.finditer(rb"\x04\x00\x00\x00zstd", data)][:CHUNKS]  # then comes the index
    data[marks[0] + 200] ^= 0xFF
    whole.write_bytes(data[: marks[-1]])
    with pytest.raises(FileError, match="no message can be read"):
        recover(whole)
    assert not list(whole.parent.glob("*.new"))


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"hello" * 100, bytes(10_000)])
def test_what_is_no_record_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(FileError, match="no message can be read"):
        recover(path)
    assert [each.name for each in tmp_path.iterdir()] == ["x.mcap"]


def test_a_chunk_that_claims_to_be_huge_is_not_unpacked(whole: Path) -> None:
    data = bytearray(whole.read_bytes())
    mark = data.index(b"\x04\x00\x00\x00zstd", data.index(b"\x04\x00\x00\x00zstd") + 1)
    data[mark - 12 : mark - 4] = (1 << 40).to_bytes(8, "little")  # the size that it claims
    whole.write_bytes(data)
    assert recover(whole).damaged == 1


def test_damage_at_random_never_crashes(whole: Path) -> None:
    data = whole.read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(150):
        broken = bytearray(data)
        for place in rng.integers(0, len(data), 5):
            broken[place] = rng.integers(0, 256)
        whole.write_bytes(broken)
        try:
            recover(whole).path.unlink()
        except FileError:
            continue


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="No such file"):
        recover(tmp_path / "none.mcap")
    with pytest.raises(FileError, match="Is a directory"):
        recover(tmp_path)


_RECORDING = """
import sys
from pathlib import Path
from revnm_client.link import open_router
from tests.server.recording_parts import observed, recorder

ticks = [observed(number) for number in range(8)]
with open_router(["tcp/127.0.0.1:0"]) as session, recorder(session, Path(sys.argv[1])) as made:
    before = made.start()
    while True:
        made.observe(ticks[before.messages % 8])
        after = made.view()
        if after.size_mb != before.size_mb:  # what was written before has been flushed
            print(before.messages, flush=True)
        before = after
"""


def test_a_recording_process_that_is_killed_loses_only_what_was_not_flushed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _RECORDING, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]) as process:
        assert process.stdout is not None
        said = [int(line) for line in itertools.islice(process.stdout, 2)]
        process.send_signal(signal.SIGKILL)
    [part] = tmp_path.glob("*.mcap.part")
    saved = recover(part)
    assert saved.messages >= said[-1] > 50
    assert len(read(saved.path)["/revnm/tick"]) > 5
