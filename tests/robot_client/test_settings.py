"""The settings of the robot: what is read, what is refused, and that an error says where it stands."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path

import pytest

from revnm_client.agent import AgentConfig
from revnm_client.errors import FileError, RevnmError
from revnm_client.geometry import Pose2
from revnm_client.messages import Mounting
from revnm_client.settings import BadSettingsError, RobotSettings, load_settings
from revnm_client.settings.assembly import agent_config
from revnm_client.settings.layout import ROOT
from revnm_client.settings.profiles import PROFILES

GUIDE = Path(__file__).parents[2] / "docs/robot.md"
GOOD = """\
robot: rover
server: [tcp/192.168.1.5:7447]
profile: megarover
driver:
  kind: zenoh
  cmd_vel: twist_stamped
limits: {max_v_mps: 0.4}
footprint: {length_m: 0.5, width_m: 0.4}
safety: {max_plan_age_s: 0.6}
log: {level: warning, format: json}
"""


KINDS = "expected one of zenoh, rmw_zenoh, kachaka, or package.module:Class"


@pytest.fixture(autouse=True)
def _clean_environment(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def load(text: str, **options) -> RobotSettings:
    Path("robot.yaml").write_text(text)
    return load_settings(Path("robot.yaml"), options=options)


def problems(text: str, **options) -> list[str]:
    with pytest.raises(BadSettingsError) as caught:
        load(text, **options)
    return caught.value.problems


def test_a_file_says_what_the_profile_does_not():
    settings = load(GOOD)
    assert (settings.robot, settings.server) == ("rover", ("tcp/192.168.1.5:7447",))
    assert (settings.driver.kind, settings.driver.options) == ("zenoh", {"cmd_vel": "twist_stamped"})
    assert settings.limits.max_v_mps == 0.4
    assert settings.limits.max_w_radps == 0.7  # the Megarover's
    assert (settings.safety.max_plan_age_s, settings.safety.max_scan_age_s) == (0.6, 0.3)
    assert (settings.log.level, settings.log.format) == ("warning", "json")


def test_what_is_in_effect_can_be_read_again():
    settings = load(GOOD)
    assert load(settings.as_yaml()) == settings
    odd = load(GOOD.replace("kind: zenoh", "kind: my_base.driver:Base").replace("twist_stamped", '"a: [b, \\"c\\"]"'))
    assert odd.driver.options["cmd_vel"] == 'a: [b, "c"]'
    assert load(odd.as_yaml()) == odd


def test_without_a_file_it_is_what_the_agent_is_by_default():
    settings = load_settings(None, options={"robot": "rover"})
    assert settings.server == ("tcp/127.0.0.1:7447",)
    assert agent_config(settings) == AgentConfig(robot="rover")


def test_the_agent_gets_limits_outline_and_ages():
    config = agent_config(
        load(GOOD + "braking: {delay_s: 0.25, margin_m: 0.05}\nlidar: {x_m: 0.1, yaw_rad: 3.14, zero_is_open: true}\n")
    )
    assert (config.robot, config.mppi.max_v_mps, config.safety.max_plan_age_s) == ("rover", 0.4, 0.6)
    assert (config.safety.braking.delay_s, config.safety.braking.margin_m) == (0.25, 0.05)
    assert (config.mppi.footprint.length_m, config.mppi.footprint.width_m) == (0.5, 0.4)
    assert config.lidar == Mounting(Pose2(0.1, 0.0, 3.14), zero_is_open=True)
    assert config.mppi.sigma_v_mps == pytest.approx(0.16)  # 2/5 of the speed, as the Megarover's 0.2 of 0.5


@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_makes_an_agent(profile):
    settings = load(f"robot: r\nserver: tcp/a:1\nprofile: {profile}\n")
    config = agent_config(settings)
    assert config.mppi.max_v_mps == PROFILES[profile].values["limits"]["max_v_mps"]
    assert PROFILES[profile].source


def test_the_turtlebot3_that_fits_both_covers_both_and_is_no_faster_than_either():
    both, one, other = (PROFILES[name].values for name in ("turtlebot3", "turtlebot3_burger", "turtlebot3_waffle"))
    for each in (one, other):
        ends = [
            (part["center_x_m"] + s * part["length_m"] / 2 for s in (-1, 1))
            for part in (both["footprint"], each["footprint"])
        ]
        (rear, front), (inner_rear, inner_front) = ends
        assert rear <= inner_rear
        assert front >= inner_front
        assert both["footprint"]["width_m"] >= each["footprint"]["width_m"]
        assert all(both["limits"][key] <= each["limits"][key] for key in both["limits"])


def test_an_outline_that_does_not_hold_the_robots_frame_is_refused():
    text = GOOD.replace("width_m: 0.4}", "width_m: 0.4, center_x_m: -0.3}")
    assert problems(text) == ["robot.yaml:8: footprint.center_x_m: -0.3: expected at most half of length_m, 0.25"]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("limits: {max_v_mps: 12.0}", "robot.yaml:7: limits.max_v_mps: 12.0: expected 0.05 to 2.0"),
        ("limits: {max_v_mps: fast}", "robot.yaml:7: limits.max_v_mps: 'fast': expected 0.05 to 2.0"),
        ("limits: {max_v_mps: .nan}", "robot.yaml:7: limits.max_v_mps: nan: expected 0.05 to 2.0"),
        ("limits: {max_v_mps: true}", "robot.yaml:7: limits.max_v_mps: True: expected 0.05 to 2.0"),
        ("limits: 0.4", "robot.yaml:7: limits: 0.4: expected a mapping of names to values"),
        (
            "limits: {max_v: 0.4}",
            "robot.yaml:7: limits.max_v: unknown key: expected one of max_a_mps2, max_alpha_radps2, max_v_mps, "
            "max_w_radps; did you mean max_v_mps?",
        ),
    ],
)
def test_a_problem_is_named_with_file_line_key_and_what_was_expected(line, expected):
    assert problems(GOOD.replace("limits: {max_v_mps: 0.4}", line)) == [expected]


def test_all_problems_are_told_in_one_run():
    text = (
        GOOD.replace("robot: rover", "robot: a/b")
        .replace("[tcp/192.168.1.5:7447]", "[tcp/a:1, 192.168.1.5]")
        .replace("json", "xml")
    )
    assert problems(text.replace("profile: megarover\n", "")) == [
        "robot.yaml:1: profile: is missing",
        "robot.yaml:1: robot: 'a/b': expected 1 to 32 of A-Z a-z 0-9 _ -, as the server knows the robot",
        "robot.yaml:2: server[1]: '192.168.1.5': expected tcp/HOST:PORT or the like, such as tcp/192.168.1.5:7447",
        "robot.yaml:9: log.format: 'xml': expected one of text, json",
    ]


def test_a_custom_robot_says_how_fast_and_how_large_it_is():
    text = "robot: r\nserver: tcp/a:1\nprofile: custom\nlimits: {max_v_mps: 0.3}\n"
    missing = "is missing: profile custom knows no robot's"
    assert problems(text) == [
        f"robot.yaml:4: limits.max_w_radps: {missing}",
        f"robot.yaml:1: footprint.length_m: {missing}",
        f"robot.yaml:1: footprint.width_m: {missing}",
    ]
    settings = load(text.replace("0.3}", "0.3, max_w_radps: 1}") + "footprint: {length_m: 0.3, width_m: 0.2}\n")
    assert settings.limits.max_w_radps == 1.0
    assert settings.braking.braking_mps2 == 0.5  # cautious


@pytest.mark.parametrize(
    ("driver", "problem"),
    [
        ("{kind: kachaka}", "driver.address: is missing"),
        (
            "{kind: kachaka, address: 'a b'}",
            "driver.address: 'a b': expected HOST or HOST:PORT, such as 192.168.1.20:26400",
        ),
        (
            "{kind: rmw_zenoh, scan_topic: 1st}",
            "driver.scan_topic: '1st': expected a name of ROS 2 such as scan or front/scan",
        ),
        ("{kind: rmw_zenoh, domain: 300}", "driver.domain: 300: expected a whole number from 0 to 232"),
        ("{kind: zenoh, domain: 3}", "driver.domain: unknown key: expected one of cmd_vel, connect, kind"),
        ("{kind: ros}", f"driver.kind: 'ros': {KINDS}"),
        ("{kind: [zenoh]}", f"driver.kind: ['zenoh']: {KINDS}"),
    ],
)
def test_a_driver_has_options_of_its_own(driver, problem):
    assert problems(f"robot: r\nserver: tcp/a:1\nprofile: megarover\ndriver: {driver}\n") == [
        f"robot.yaml:4: {problem}"
    ]


def test_a_driver_of_somebodys_gets_its_options_as_they_are():
    settings = load("robot: r\nserver: tcp/a:1\nprofile: megarover\ndriver: {kind: my.base:Base, port: /dev/ttyUSB0}\n")
    assert (settings.driver.kind, settings.driver.options) == ("my.base:Base", {"port": "/dev/ttyUSB0"})


def test_the_environment_overrides_the_file_and_options_override_both(monkeypatch):
    monkeypatch.setenv("REVNM_ROBOT__LIMITS__MAX_V_MPS", "0.3")
    monkeypatch.setenv("REVNM_ROBOT__SERVER", "[tcp/a:1, tcp/b:2]")
    monkeypatch.setenv("REVNM_ROBOT__SAFETY", "{max_scan_age_s: 0.2}")
    monkeypatch.setenv("REVNM_ROBOT__ROBOT", "other")
    settings = load(GOOD, robot="third")
    assert settings.limits.max_v_mps == 0.3
    assert settings.server == ("tcp/a:1", "tcp/b:2")
    assert (settings.safety.max_scan_age_s, settings.safety.max_plan_age_s) == (0.2, 0.6)
    assert settings.robot == "third"


def test_a_problem_names_the_variable_or_the_option(monkeypatch):
    monkeypatch.setenv("REVNM_ROBOT__LIMITS__MAX_V_MPS", "3")
    monkeypatch.setenv("REVNM_ROBOT__LIMIT", "1")
    assert problems(GOOD, server=["junk"]) == [
        "REVNM_ROBOT__LIMIT: limit: unknown key: expected one of braking, driver, footprint, lidar, limits, log, "
        "profile, robot, safety, security, server; did you mean limits?",
        "--connect: server[0]: 'junk': expected tcp/HOST:PORT or the like, such as tcp/192.168.1.5:7447",
        "REVNM_ROBOT__LIMITS__MAX_V_MPS: limits.max_v_mps: 3: expected 0.05 to 2.0",
    ]
    monkeypatch.setenv("REVNM_ROBOT__LIMIT", "{")
    with pytest.raises(FileError, match=r"^REVNM_ROBOT__LIMIT:1: is no YAML"):
        load(GOOD)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("log:\n  level: info\n  level: info\n", r"^robot.yaml:3: log.level: stands here a second time"),
        ("robot: &x a\nserver: *x\n", r"^robot.yaml:2: \*x: expected the value itself"),
        ("robot: " + "[" * 5000, r"^robot.yaml:1: expected at most 10 levels"),
        ("robot: [a\n", r"^robot.yaml:2: is no YAML"),
        ("- a\n", r"^robot.yaml:1: expected a mapping"),
        ("? [a, b]\n: c\n", r"^robot.yaml:1: expected keys of"),
        ("robot: !!python/object:os.system x\n", r"^robot.yaml:1: is no YAML"),
        ("a: 1\n---\nb: 2\n", r"^robot.yaml:\d: is no YAML"),
        ("robot: " + "9" * 5000, r"^robot.yaml: is no YAML"),
        ("robot: \0\n", r"^robot.yaml: is no YAML"),
        ("# " + "x" * 100_000, r"^robot.yaml: is larger than 100000 bytes"),
    ],
)
def test_a_hostile_file_is_refused(text, problem):
    with pytest.raises(FileError, match=problem):
        load(text)


def test_what_is_no_text_or_not_there_is_refused():
    Path("robot.yaml").write_bytes(b"robot: \xff\n")
    with pytest.raises(FileError, match="no UTF-8"):
        load_settings(Path("robot.yaml"))
    with pytest.raises(FileError, match=r"nowhere.yaml: cannot be read: No such file"):
        load_settings(Path("nowhere.yaml"))


def test_a_damaged_file_gives_settings_or_an_error_of_ours():
    chance = random.Random(7)
    for _ in range(300):
        text = list(GOOD)
        for _ in range(chance.randint(1, 4)):
            text[chance.randrange(len(text))] = chance.choice("{}[]:,&*!|>'\"%@` \n\t-?#~0a")
        try:
            settings = load("".join(text))
        except RevnmError as error:
            assert "robot.yaml" in str(error)  # noqa: PT017
        else:
            agent_config(settings)


def test_the_guides_twelve_lines_are_right():
    example, *_ = re.findall(r"```yaml\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    assert len(example.splitlines()) == 12
    settings = load(example)
    assert settings.driver.options == {"connect": ("tcp/127.0.0.1:7447",), "cmd_vel": "twist"}
    agent_config(settings)


def test_the_guide_has_every_key_and_every_profile():
    text = GUIDE.read_text()
    names = ("security", "limits", "footprint", "lidar", "braking", "safety", "log")
    sections = [ROOT.fields[name].fields for name in names]
    assert [key for fields in sections for key in fields if key not in text] == []
    assert [name for name in PROFILES if name not in text] == []


def test_the_schema_says_what_the_file_may_hold():
    schema = json.loads(json.dumps(ROOT.schema()))
    assert schema["required"] == ["robot", "server", "profile"]
    assert schema["properties"]["limits"]["properties"]["max_v_mps"] == {
        "type": "number",
        "minimum": 0.05,
        "maximum": 2.0,
    }
    assert "custom" in schema["properties"]["profile"]["enum"]
    assert {each.get("title") for each in schema["properties"]["driver"]["anyOf"]} == {
        "zenoh",
        "rmw_zenoh",
        "kachaka",
        None,
    }
