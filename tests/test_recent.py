"""A cache that forgets the oldest."""

from __future__ import annotations

from rlgcomp.diagnosis.evidence.recent import Recent


def test_what_was_asked_for_last_stays() -> None:
    recent = Recent[str, str](5, len)
    recent.put("a", "xx")
    recent.put("b", "xx")
    assert recent.get("a") == "xx"
    recent.put("c", "xx")
    assert recent.get("b") is None
    assert (recent.get("a"), recent.get("c")) == ("xx", "xx")


def test_what_is_larger_than_all_room_is_alone() -> None:
    recent = Recent[str, str](5, len)
    recent.put("a", "xx")
    assert recent.put("b", "xxxxxxxx") == "xxxxxxxx"
    assert recent.get("a") is None
    assert recent.get("b") == "xxxxxxxx"


def test_it_is_made_once() -> None:
    made: list[int] = []
    recent = Recent[str, list[int]](1)
    for _ in range(2):
        recent.of("a", lambda: made.append(1) or made)
    assert made == [1]


def test_what_is_cleared_makes_room() -> None:
    recent = Recent[str, str](5, len)
    recent.put("a", "xxxx")
    recent.clear()
    assert recent.get("a") is None
    recent.put("b", "xxx")
    recent.put("c", "xx")
    assert recent.get("b") == "xxx"
