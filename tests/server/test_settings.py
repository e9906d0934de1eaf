from __future__ import annotations

from pathlib import Path

import pytest

from revnm_client.errors import ConfigError, FileError
from revnm_server.settings import BadSettingsError, load_settings


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return tmp_path / "server.yaml"


def test_command_line_over_environment_over_file(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config.write_text("http: {port: 1001, host: 127.0.0.2}\nrobots: {a: 1}\nperception: {tick_hz: 4}\n")
    monkeypatch.setenv("REVNM_HTTP__PORT", "1002")
    monkeypatch.setenv("REVNM_PERCEPTION__TICK_HZ", "5")
    settings = load_settings(config, overrides={"http": {"port": 1003}})
    assert (settings.http.port, settings.http.host) == (1003, "127.0.0.2")
    assert settings.perception.tick_hz == 5
    assert settings.robots == {"a": 1}


def test_an_error_names_file_line_and_key(config: Path) -> None:
    config.write_text("robots:\n  rover: 3\nhttp:\n  port: 80000\n  speed: 1\n")
    with pytest.raises(ConfigError) as caught:
        load_settings(config)
    assert f"{config}:4: http.port: " in str(caught.value)
    assert f"{config}:5: http.speed: " in str(caught.value)


def test_an_unknown_key_is_told_with_the_known_ones(config: Path) -> None:
    config.write_text("camera:\n  ur: rtsp://cam/live\nperceptoin: {}\n")
    with pytest.raises(BadSettingsError) as caught:
        load_settings(config)
    problems = caught.value.problems
    assert f"{config}:2: camera.ur: unknown key: expected one of name, url; did you mean url?" in problems
    assert any(p.startswith(f"{config}:3: perceptoin: ") and p.endswith("did you mean perception?") for p in problems)


def test_an_error_names_the_item_of_a_list(config: Path) -> None:
    config.write_text("zenoh:\n  listen:\n    - tcp/127.0.0.1:7447\n    - 7\n")
    with pytest.raises(ConfigError, match=rf"^{config}:4: zenoh\.listen\[1\]: "):
        load_settings(config)


def test_an_error_names_whoever_said_it(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config.write_text("http: {port: 1000}\nperception: {threads: 2}\n")
    monkeypatch.setenv("REVNM_HTTP__PORT", "no port")
    with pytest.raises(ConfigError, match=r"^REVNM_HTTP__PORT: http\.port: "):
        load_settings(config)
    with pytest.raises(ConfigError, match=r"^perception\.threads: "):
        load_settings(config, overrides={"http": {"port": 1}, "perception": {"threads": 0}})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("http:\n  port: 1\n  port: 2\n", ":3: http.port: stands here a second time"),
        ("a: &a {port: 1}\nhttp: *a\n", ":2: *a: expected the value itself"),
        ("http:\n port: 1\n  host: x\n", ":3: is no YAML"),
        ("camera: " + 20 * "[" + 20 * "]", "levels of nesting"),
    ],
)
def test_what_would_be_misread_is_refused(config: Path, text: str, said: str) -> None:
    config.write_text(text)
    with pytest.raises(FileError) as caught:
        load_settings(config)
    assert f"{config}" in str(caught.value)
    assert said in str(caught.value)


def test_an_environment_variable_that_is_no_json_is_an_error_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REVNM_ROBOTS", "rover=3")
    with pytest.raises(ConfigError, match="robots"):
        load_settings()


@pytest.mark.parametrize("text", ["- 1", "a: [", "x"])
def test_a_file_that_is_no_mapping_is_refused(config: Path, text: str) -> None:
    config.write_text(text)
    with pytest.raises(FileError, match=r"server\.yaml"):
        load_settings(config)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "camera.example"])
def test_an_address_that_others_reach_needs_a_token_or_plain_words(host: str) -> None:
    with pytest.raises(ConfigError, match="insecure-http"):
        load_settings(overrides={"http": {"host": host}})
    assert load_settings(overrides={"http": {"host": host, "insecure": True}}).http.host == host
    assert load_settings(overrides={"http": {"host": host, "token": "a" * 16}}).http.host == host


@pytest.mark.parametrize(
    ("http", "said"),
    [
        ({"viewer_token": "v" * 16}, "needs a token"),
        ({"viewer_token": "v" * 16, "token": "v" * 16}, "the same"),
        ({"certificate": "/cert.pem"}, "expected both"),
        ({"key": "/key.pem"}, "expected both"),
        ({"token": "short"}, "16"),
    ],
)
def test_tokens_and_certificates_that_do_not_go_together_are_refused(http: dict[str, str], said: str) -> None:
    with pytest.raises(ConfigError, match=said) as caught:
        load_settings(overrides={"http": http})
    assert "vvvv" not in str(caught.value)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.5.0.1"])
def test_loopback_needs_no_token(host: str) -> None:
    assert load_settings(overrides={"http": {"host": host}}).http.loopback


@pytest.mark.parametrize("robots", [{}, {"a": 1, "b": 1}, {"a/b": 1}, {"a": 587}, {"a": -1}])
def test_robots_have_names_and_tags_of_their_own(robots: dict[str, int]) -> None:
    with pytest.raises(ConfigError, match="robots"):
        load_settings(overrides={"robots": robots})


def test_secrets_are_neither_shown_nor_told() -> None:
    secret = "hushhushhushhush"
    settings = load_settings(overrides={"http": {"token": secret}, "camera": {"url": "rtsp://u:hushhush@cam/live"}})
    assert "hushhush" not in repr(settings)
    with pytest.raises(ConfigError) as caught:
        load_settings(overrides={"http": {"token": "hush hush"}, "camera": {"url": "http://u:hushhush@cam"}})
    assert "hush" not in str(caught.value)


def test_the_map_planner_is_chosen_and_told_of_the_robots_in_the_file(config: Path) -> None:
    settings = load_settings()
    assert settings.perception.planner == "revnm"
    assert settings.perception.calibration_dir is None
    config.write_text("camera: {name: hall}\nperception: {planner: bev, tag_height_m: 0.2, calibration_dir: kept}\n")
    settings = load_settings(config)
    assert settings.camera.name == "hall"
    assert (settings.perception.planner, settings.perception.tag_height_m) == ("bev", 0.2)
    assert settings.perception.calibration_dir == Path("kept")


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("camera", "name", "a/b"),
        ("camera", "name", "../hall"),
        ("perception", "planner", "astar"),
        ("perception", "tag_height_m", -0.1),
        ("perception", "robot_length_m", 0.0),
        ("perception", "robot_width_m", ".inf"),
    ],
)
def test_a_wrong_value_for_the_map_planner_names_its_place(config: Path, section: str, key: str, value: object) -> None:
    config.write_text(f"{section}:\n  {key}: {value}\n")
    with pytest.raises(ConfigError) as caught:
        load_settings(config)
    assert f"{config}:2: {section}.{key}: " in str(caught.value)


@pytest.mark.parametrize("listen", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/edge.local:7447", "tcp/192.168.1.5:7447"])
def test_an_endpoint_that_others_reach_needs_credentials_or_plain_words(listen: str) -> None:
    with pytest.raises(ConfigError, match="insecure-zenoh"):
        load_settings(overrides={"zenoh": {"listen": ["tcp/127.0.0.1:7447", listen]}})
    for said in ({"insecure": True}, {"passwords": "passwords.txt"}):
        assert load_settings(overrides={"zenoh": {"listen": [listen], **said}}).zenoh.listen == (listen,)


@pytest.mark.parametrize("listen", ["tcp/127.0.0.1:7447", "tcp/localhost:7447", "tcp/[::1]:0", "unixsock-stream/a"])
def test_an_endpoint_that_only_this_machine_reaches_needs_nothing(listen: str) -> None:
    assert load_settings(overrides={"zenoh": {"listen": [listen]}}).zenoh.listen == (listen,)


TLS = {"listen": ["tls/0.0.0.0:7447"], "certificate": "c.pem", "key": "c.key"}


@pytest.mark.parametrize(
    ("zenoh", "said"),
    [
        (TLS, "insecure-zenoh"),  # encrypted, and open to all
        (TLS | {"authority": "a.pem", "key": None}, "certificate and key: expected both"),
        ({"authority": "a.pem"}, "authority needs the server's certificate"),
        (TLS | {"authority": "a.pem", "listen": ["tcp/0.0.0.0:1"]}, "expected tls/HOST:PORT with a certificate"),
        ({"listen": ["tls/127.0.0.1:1"]}, "expected tls/HOST:PORT with a certificate, and only with one"),
        (TLS | {"authority": "a.pem", "passwords": "p.txt"}, "expected one of them"),
        (TLS | {"authority": "a.pem", "insecure": True}, "insecure: expected without"),
    ],
)
def test_zenoh_settings_that_contradict_themselves_are_refused(zenoh: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load_settings(overrides={"zenoh": zenoh})


def test_the_certificates_are_those_of_page_and_router() -> None:
    zenoh = TLS | {"authority": "a.pem"}
    settings = load_settings(overrides={"zenoh": zenoh, "http": {"certificate": "h.pem", "key": "h.key"}})
    assert settings.certificates == [Path("c.pem"), Path("a.pem"), Path("h.pem")]
    assert load_settings().certificates == []


def test_certificates_of_robots_beside_the_authority_are_looked_at_too(tmp_path: Path) -> None:
    (tmp_path / "rover").mkdir()
    (tmp_path / "rover/robot.pem").touch()
    settings = load_settings(overrides={"zenoh": TLS | {"authority": str(tmp_path / "authority.pem")}})
    assert settings.certificates == [Path("c.pem"), tmp_path / "authority.pem", tmp_path / "rover/robot.pem"]


def test_environment_over_secrets_over_file(config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config.write_text("http: {port: 1001, token: tokenofthefile123}\n")
    secrets = tmp_path / "secrets"
    secrets.mkdir()
    (secrets / "REVNM_HTTP__TOKEN").write_text("tokenofthesecret1\n")  # as editors and echo end it
    (secrets / "REVNM_HTTP__PORT").write_text("1002")
    (secrets / "keystore_of_another_program").write_bytes(b"\xff")
    monkeypatch.setenv("REVNM_HTTP__PORT", "1003")
    http = load_settings(config, secrets=secrets).http
    assert http.token is not None
    assert (http.token.get_secret_value(), http.port) == ("tokenofthesecret1", 1003)


def test_a_bad_secret_is_told_by_its_file_and_not_shown(tmp_path: Path) -> None:
    (tmp_path / "REVNM_HTTP__TOKEN").write_text("hush")
    with pytest.raises(BadSettingsError) as caught:
        load_settings(secrets=tmp_path)
    assert str(caught.value).startswith(f"{tmp_path}/REVNM_HTTP__TOKEN: http.token: ")
    assert "hush" not in str(caught.value)


def test_a_secret_that_is_no_text_is_an_error_of_ours(tmp_path: Path) -> None:
    (tmp_path / "REVNM_HTTP__TOKEN").write_bytes(b"hush\xff")
    with pytest.raises(FileError, match=f"{tmp_path}: expected secrets in UTF-8") as caught:
        load_settings(secrets=tmp_path)
    assert "hush" not in str(caught.value)
