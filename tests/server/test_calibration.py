"""The calibration learns random cameras from short drives, knows how well, and notices what went wrong."""

import math

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.calibration.calibrator import Calibrator
from revnm_server.calibration.keyframes import DRIVES_OF_A_ROBOT, Keyframe, Travel
from revnm_server.floor_camera import FloorCamera
from revnm_sim.measures.calibration_command import measure
from revnm_sim.measures.calibration_course import MOUNT, SIZE_PX, Learner, Moment, drive, random_camera


def test_half_a_metre_with_corners_is_enough():
    result = measure(0.5, corners=True, seeds=[(0, number, 5) for number in range(80)])
    assert result["median_1m_cm"] <= 4.0
    assert result["median_2m_cm"] <= 12.0
    assert 0.90 <= result["in_95_1m"] <= 0.99
    assert 0.90 <= result["in_95_2m"] <= 0.99


def test_two_metres_without_corners_are_enough():
    result = measure(2.0, corners=False, seeds=[(0, number, 20) for number in range(25)])
    assert result["median_1m_cm"] <= 8.0
    assert result["median_2m_cm"] <= 18.0
    assert result["in_95_1m"] >= 0.90
    assert result["in_95_2m"] >= 0.90


def learnt(seed: int, way_m: float = 1.5) -> tuple[FloorCamera, Learner, list[Moment]]:
    rng = np.random.default_rng(seed)
    camera, learner = random_camera(rng), Learner()
    moments = drive(camera, rng, way_m)
    for moment in moments:
        learner.see(moment)
    return camera, learner, moments


def test_a_robot_first_seen_at_the_horizon_does_not_run_away():
    rng = np.random.default_rng((0, 2, 40))
    camera, learner = random_camera(rng), Learner(corners=False)
    learner.see(drive(camera, rng, 4.0)[0])
    assert np.isfinite(learner.calibrator.belief.covariance).all()
    assert math.hypot(*learner.place()[:2]) < 200.0


def test_it_knows_how_far_it_is():
    rng = np.random.default_rng(3)
    camera, learner = random_camera(rng), Learner()
    assert learner.calibrator.state.status == "unknown"
    spreads = []
    for moment in drive(camera, rng, 1.5):
        learner.see(moment)
        spreads.append(learner.calibrator.state.spread_2_m)
    assert learner.calibrator.state.status == "good"
    assert spreads[0] > 3 * spreads[-1]
    assert learner.calibrator.state.progress == 1.0


def test_none_of_many_robots_loses_its_place():
    rng, count = np.random.default_rng(8), 30
    camera, calibrator = random_camera(rng), Calibrator(SIZE_PX)
    drives = [drive(camera, rng, 0.6) for _ in range(count)]
    travels = [Travel(moments[0].odom_from_robot) for moments in drives]
    for number in range(13):
        moments = [each[number] for each in drives]
        travels = [each.on(moment.odom_from_robot) for each, moment in zip(travels, moments, strict=True)]
        calibrator.observe(
            *(
                Keyframe(moment.pixel, moment.heading, moment.corners, travel, MOUNT, robot * DRIVES_OF_A_ROBOT)
                for robot, (moment, travel) in enumerate(zip(moments, travels, strict=True))
            )
        )
    places = [calibrator.floor_from_robot(each, robot * DRIVES_OF_A_ROBOT) for robot, each in enumerate(travels)]
    assert None not in places
    apart_m = [
        math.dist(place[:2], moments[12].floor_from_robot[:2])
        for place, moments in zip(places, drives, strict=True)
        if place is not None
    ]
    assert np.median(apart_m) < 0.3
    assert calibrator.state.keyframes == 2 * count


def test_one_wrong_sighting_changes_nothing():
    _, learner, moments = learnt(5)
    before = learner.calibrator.belief.mean
    wrong = Moment(
        moments[-1].pixel + 90.0,
        moments[-1].heading,
        moments[-1].corners + 90.0,
        moments[-1].odom_from_robot @ Pose2(0.15, 0.0, 0.0),
        moments[-1].floor_from_robot,
    )
    learner.see(wrong)
    np.testing.assert_array_equal(learner.calibrator.belief.mean, before)
    assert learner.place() is not None
    assert (learner.calibrator.state.event, learner.calibrator.state.restarts) == (None, 0)


@pytest.mark.parametrize("way_m", [1.0, 4.0])  # after a long drive the focal length is sure before and after
def test_a_knock_is_noticed_and_learnt_again(way_m):
    camera, learner, moments = learnt(7, way_m=way_m)
    rng = np.random.default_rng(70)
    knocked = FloorCamera(
        SIZE_PX, camera.focal_px, camera.pitch_rad + math.radians(5.0), camera.roll_rad, camera.height_m
    )
    later = drive(knocked, rng, 2.0)
    join = moments[-1].odom_from_robot @ later[0].odom_from_robot.inverse()
    places = []
    for moment in later:
        odom = join @ moment.odom_from_robot
        learner.see(Moment(moment.pixel, moment.heading, moment.corners, odom, moment.floor_from_robot))
        places.append(learner.place())
    assert None in places[:5]  # while sightings and odometry disagree, nothing is claimed
    assert "jumped" in (learner.calibrator.state.event or "")
    assert learner.calibrator.state.restarts >= 1
    errors, _ = learner.errors(knocked, later[-1].floor_from_robot, 1.0)
    assert errors.mean() < 0.06
    assert learner.calibrator.belief.mean[1] == pytest.approx(knocked.pitch_rad, abs=math.radians(1.5))


def test_slip_of_the_wheels_is_an_outlier():
    camera, rng = random_camera(np.random.default_rng(11)), np.random.default_rng(12)
    learner = Learner()
    moments = drive(camera, rng, 2.0)
    slip = Pose2(0.0, 0.0, 0.0)
    for i, moment in enumerate(moments):
        if i == 20:
            slip = Pose2(0.06, 0.0, 0.0)  # wheels turned by 6 cm, the robot did not
        odom = moment.odom_from_robot @ slip
        learner.see(Moment(moment.pixel, moment.heading, moment.corners, odom, moment.floor_from_robot))
    errors, _ = learner.errors(camera, moments[-1].floor_from_robot, 1.0)
    assert errors.mean() < 0.06


def test_a_lens_that_bends_is_learnt_from_a_long_drive():
    rng = np.random.default_rng(21)
    camera = FloorCamera(SIZE_PX, 300.0, math.radians(30.0), 0.0, 2.8, -0.12)
    learner = Learner()
    for _ in range(3):
        learner.begin_drive()
        for moment in drive(camera, rng, 2.0):
            learner.see(moment)
    assert learner.calibrator.belief.mean[4] == pytest.approx(-0.12, abs=0.05)


def test_what_was_kept_serves_a_new_drive_at_once():
    camera, learner, _ = learnt(9, way_m=2.0)
    again = Learner(calibrator=Calibrator(SIZE_PX, kept=learner.calibrator.belief))
    assert again.calibrator.state.status == "good"
    moments = drive(camera, np.random.default_rng(90), 0.5)
    again.see(moments[0])
    errors, _ = again.errors(camera, moments[0].floor_from_robot, 1.0)
    assert errors.mean() < 0.10  # the heading of one sighting is all that is missing
