"""``revnm-server models``: what is known, and fetching it."""

from __future__ import annotations

import hashlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from revnm_client.errors import ConfigError
from revnm_server.cli import main
from revnm_server.commands.models import fetch_known
from revnm_server.networks.configured_depth import load_depth_network
from revnm_server.networks.model_catalogue import CatalogueEntry, load_catalogue
from revnm_server.settings import load_settings

from .file_server import PATH, FileServer
from .foreign_depth import write_depth
from .waiting import eventually


@pytest.fixture
def network(tmp_path: Path) -> bytes:
    return write_depth(tmp_path / "net.onnx", shape=(1, 3, 64, 64)).read_bytes()


@pytest.fixture
def server(network: bytes) -> Iterator[FileServer]:
    with FileServer(network) as running:
        yield running


def sum_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def entry(url: str, **file: object) -> CatalogueEntry:
    files = [{"url": url, **file}]
    about = {"about": "a network", "licence": "MIT", "source": "https://example.com"}
    return CatalogueEntry.model_validate({**about, "files": files, "depth": {"kind": "disparity"}})


def test_the_list_names_licence_size_kind_and_whether_a_sum_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["models", "list"]) == 0
    shown = capsys.readouterr().out
    for name in load_catalogue():
        assert f"{name}\n" in shown
    assert "99 MB, Apache-2.0, disparity, ready" in shown
    assert "size unknown, Apache-2.0, depth, needs --sha256" in shown


def test_every_known_network_is_free_to_use_pinned_or_without_a_sum() -> None:
    for known in load_catalogue().values():
        assert known.licence in {"Apache-2.0", "MIT", "BSD-2-Clause"}
        for file in known.files:
            assert file.url.startswith(known.source)
            assert file.sha256 is None or "/resolve/main/" not in file.url


def test_what_was_fetched_loads_with_the_settings_that_are_printed(
    server: FileServer, network: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["models", "fetch", server.url, "--sha256", sum_of(network).upper(), "--to", str(tmp_path / "to")]) == 0
    config = tmp_path / "server.yaml"
    printed = capsys.readouterr()
    assert "downloaded, sha256 is right" in printed.err
    config.write_text(printed.out.replace("disparity | depth | metric_canonical", "disparity"))
    settings = load_settings(config).depth
    assert settings.model == tmp_path / "to" / "net.onnx"
    load_depth_network(settings)
    server.does.status = 404  # it is not asked again
    assert main(["models", "fetch", server.url, "--sha256", sum_of(network), "--to", str(tmp_path / "to")]) == 0
    assert "there already" in capsys.readouterr().err


def test_a_known_network_comes_with_its_settings(server: FileServer, network: bytes, tmp_path: Path) -> None:
    known = {"net": entry(server.url, sha256=sum_of(network), size_bytes=len(network))}
    settings = fetch_known(known, "net", None, tmp_path)
    path = tmp_path / "net" / "net.onnx"
    assert settings == {"model": str(path), "sha256": sum_of(network), "kind": "disparity"}
    assert path.read_bytes() == network


def test_files_beside_the_model_come_too(server: FileServer, network: bytes, tmp_path: Path) -> None:
    server.does.location = {"/net.onnx_data": PATH}
    file = {"sha256": sum_of(network)}
    plain = entry(server.url, **file)
    both = (plain.files[0], plain.files[0].model_copy(update={"url": server.root + "/net.onnx_data"}))
    settings = fetch_known({"net": plain.model_copy(update={"files": both})}, "net", None, tmp_path)
    assert settings["data"] == {"net.onnx_data": sum_of(network)}
    assert (tmp_path / "net" / "net.onnx_data").read_bytes() == network


def test_without_a_sum_nothing_is_fetched(server: FileServer, network: bytes, tmp_path: Path) -> None:
    known = {"net": entry(server.url)}
    with pytest.raises(ConfigError, match=r"its sha256 is not known here; take it from https://example\.com"):
        fetch_known(known, "net", None, tmp_path)
    assert server.asked == []
    assert fetch_known(known, "net", sum_of(network), tmp_path)["sha256"] == sum_of(network)


def test_a_known_sum_is_not_overruled(server: FileServer, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"is known to have {'a' * 64}"):
        fetch_known({"net": entry(server.url, sha256="a" * 64)}, "net", "b" * 64, tmp_path)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["depth-anything-9"], "expected a URL or one of depth-anything-v2-small"),
        (["https://example.com/x.onnx"], "expected --sha256"),
        (["https://example.com/", "--sha256", "0" * 64], "expected the name of a file at the end"),
        (["http://example.com/x.onnx"], "expected https://"),
        (["depth-anything-3-base"], "its sha256 is not known here"),
        (["depth-anything-3-base", "--sha256", "abc"], "expected 64 hexadecimal digits"),
    ],
)
def test_what_the_user_can_mend_is_said_in_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["models", "fetch", *arguments]) == 2
    output = capsys.readouterr().err
    assert said in output
    assert output.count("\n") == 1


def test_an_interrupt_keeps_the_part_for_the_next_time(server: FileServer, tmp_path: Path) -> None:
    content = bytes(range(256)) * 2000
    server.does.content, server.does.sends, server.does.stalls = content, len(content) // 2, True
    words = ["models", "fetch", server.url, "--sha256", sum_of(content), "--to", str(tmp_path / "to")]
    # Where the tests run in the background, SIGINT is ignored, and children inherit that.
    code = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code += "from revnm_server.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *words]
    part = tmp_path / "to" / "net.onnx.part"
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            eventually(lambda: part.exists() and part.stat().st_size > 0, within_s=30.0)
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=10.0)
        finally:
            process.kill()
    assert (process.returncode, error.strip()) == (130, "revnm-server: interrupted; run it again to go on")
    kept = part.read_bytes()
    assert content.startswith(kept)
    server.does.sends, server.does.stalls = None, False
    assert main(words) == 0
    assert server.asked[1]["Range"] == f"bytes={len(kept)}-"
    assert (tmp_path / "to" / "net.onnx").read_bytes() == content
