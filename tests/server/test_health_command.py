from __future__ import annotations

from pathlib import Path

import pytest
import trustme

from revnm_server.app import running_server
from revnm_server.cli import main
from revnm_server.settings import load_settings

from .free_port import free_port


@pytest.mark.parametrize("guarded", [False, True], ids=["open", "https-and-token"])
def test_a_server_that_works_is_healthy_until_it_ends(
    tiny_bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], guarded: bool
) -> None:
    config = tmp_path / "server.yaml"
    port = free_port()
    lines = ["zenoh: {listen: ['tcp/127.0.0.1:0']}", f"perception: {{bundle: {tiny_bundle}}}"]
    if guarded:
        issued = trustme.CA().issue_cert("camera.example")  # not the address that is asked
        issued.cert_chain_pems[0].write_to_path(str(tmp_path / "cert.pem"))
        issued.private_key_pem.write_to_path(str(tmp_path / "key.pem"))
        files = f"certificate: {tmp_path}/cert.pem, key: {tmp_path}/key.pem"
        lines.append(f"http: {{host: 0.0.0.0, port: {port}, token: 0123456789abcdefXYZ, {files}}}")
    else:
        lines.append(f"http: {{port: {port}}}")
    config.write_text("\n".join(lines))
    with running_server(load_settings(config)):
        assert main(["health", "--config", str(config)]) == 0
    assert capsys.readouterr().err == ""
    assert main(["health", "--config", str(config)]) == 1
    assert f"127.0.0.1:{port}/healthz: " in capsys.readouterr().err


def test_settings_that_are_wrong_are_told_apart(tmp_path: Path) -> None:
    assert main(["health", "--config", str(tmp_path / "server.yaml")]) == 2
