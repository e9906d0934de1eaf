from __future__ import annotations

import pytest

from revnm_client.pacing import Pacer


def test_due_times_do_not_drift():
    pacer, now_s = Pacer(0.05, 100.0), 100.0
    for tick in range(1, 1001):
        now_s = pacer.next_due_s(now_s + 0.013)  # every tick takes 13 ms, and is called in time
        assert now_s == pytest.approx(100.0 + 0.05 * tick, abs=1e-9)


def test_a_stall_is_not_made_up_for():
    pacer = Pacer(0.05, 100.0)
    assert pacer.next_due_s(100.01) == pytest.approx(100.05)
    assert pacer.next_due_s(100.36) == pytest.approx(100.40)  # 100.10 to 100.35 are left out
    assert pacer.next_due_s(100.41) == pytest.approx(100.45)


def test_a_due_time_comes_once():
    pacer = Pacer(0.05, 100.0)
    assert pacer.next_due_s(100.0) == pytest.approx(100.05)
    assert pacer.next_due_s(100.0) == pytest.approx(100.10)
