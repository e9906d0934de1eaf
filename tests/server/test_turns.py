"""Everybody has a turn, and nobody two while another waits."""

from __future__ import annotations

from collections import Counter

from revnm_server.tick.turns import Turns


def test_all_have_their_turn_where_there_are_few() -> None:
    turns = Turns(2)
    assert [turns.next(["a", "b"]) for _ in range(3)] == [["a", "b"]] * 3
    assert turns.next([]) == []


def test_many_take_turns() -> None:
    turns, names = Turns(3), [f"r{number}" for number in range(7)]
    counts = Counter(name for _ in range(7) for name in turns.next(names))
    assert counts == dict.fromkeys(names, 3)


def test_who_comes_later_is_first_and_who_was_away_is_not_owed_more() -> None:
    turns = Turns(1)
    assert [turns.next(["a", "b"]) for _ in range(4)] == [["a"], ["b"], ["a"], ["b"]]
    assert [turns.next(["a", "b", "c"]) for _ in range(4)] == [["c"], ["a"], ["b"], ["c"]]
