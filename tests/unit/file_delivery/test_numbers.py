"""Numbers of transactions: never used twice."""

import threading

from file_delivery.numbers import Numbers, beginning


def test_numbers_follow_one_another_over_restarts(tmp_path):
    first = Numbers(tmp_path / "n").take()
    assert [Numbers(tmp_path / "n").take() - first for _ in range(300)] == list(range(1, 301))
    assert 1 << 48 < first < 1 << 63


def test_a_lost_or_damaged_state_does_not_repeat_numbers(tmp_path):
    path, numbers = tmp_path / "n", Numbers(tmp_path / "n")
    used = [numbers.take() for _ in range(3)]
    for damage in (path.unlink, lambda: path.write_text("x"), lambda: path.write_text("9" * 30)):
        damage()
        used += [numbers.take() for _ in range(3)]
    assert sorted(set(used)) == used


def test_a_folder_that_cannot_be_written_costs_the_order_only(tmp_path):
    numbers = Numbers(tmp_path / "missing" / "n")
    assert len({numbers.take() for _ in range(100)}) == 100


def test_two_takers_never_get_the_same(tmp_path):
    got: list[int] = []
    path = tmp_path / "n"
    work = [
        threading.Thread(target=lambda: got.extend(Numbers(path).take() for _ in range(50)))
        for _ in range(4)
    ]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    assert len(set(got)) == 200


def test_a_later_beginning_is_beyond_an_earlier_one():
    found = [beginning() >> 10 for _ in range(1000)]
    assert found == sorted(found)
