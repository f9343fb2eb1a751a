"""Recorded throws: the bodies by adding up small cubes, logs by frames that are made up."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from evidence.hardware import throws
from evidence.hardware.data_set import DataError
from evidence.hardware.throws_judge import Found, judged, pooled

NAMES = [*throws.NEEDED, "erpm[0]", "other"]


def log_of(monkeypatch: pytest.MonkeyPatch, rows: np.ndarray) -> None:
    frames = [SimpleNamespace(data=row) for row in rows.tolist()]
    loaded = SimpleNamespace(field_names=NAMES, frames=lambda: iter(frames))
    module = ModuleType("orangebox")
    module.__dict__["Parser"] = SimpleNamespace(load=lambda _path: loaded)
    monkeypatch.setitem(sys.modules, "orangebox", module)


def test_a_body_weighs_and_resists_as_the_sum_of_its_parts() -> None:
    """Blocks as 6 x 6 x 6 points each, about their common centre; the frame as its drawing."""
    body = throws.frame_with_blocks(throws.SETS["config_a"])
    assert body.mass_kg == pytest.approx(0.1785 + 4 * 0.0701)
    steps = (np.arange(60) + 0.5) / 60 - 0.5
    points, masses = [], []
    for x in (-0.009, 0.009):
        for y in (-0.063, 0.063):
            cells = np.stack(np.meshgrid(*(s * steps for s in throws.BLOCK_M)), -1).reshape(-1, 3)
            points.append(cells + np.array([x, y, -0.022]))
            masses.append(np.full(len(cells), 0.0701 / len(cells)))
    every, m = np.concatenate(points), np.concatenate(masses)
    com = (m @ every + 0.1785 * throws.FRAME_COM_M) / body.mass_kg
    d = every - com
    own = np.einsum("i,ijk->jk", m, (d * d).sum(1)[:, None, None] * np.eye(3))
    own -= np.einsum("i,ij,ik->jk", m, d, d)
    own += throws.FRAME_KG_M2 + throws.moved(0.1785, throws.FRAME_COM_M - com)
    np.testing.assert_allclose(body.inertia_kg_m2, own, rtol=0, atol=1e-7)


def test_a_log_becomes_columns_in_si_units(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    t_us = 1000 * np.arange(200)
    counts = np.zeros((200, 9))
    counts[:, 0] = t_us + 7_000_000
    counts[:, 1:4] = np.array([16.384, 2 * 16.384, -16.384]) * 180.0 / np.pi
    counts[:, 4:7] = np.array([2048.0, 0.0, 1024.0])
    counts[20:, 7] = 100.0  # 10 000 electrical turns a minute
    log_of(monkeypatch, counts)
    throws.write_csv(tmp_path / "log", tmp_path / "log.csv")
    table = np.genfromtxt(tmp_path / "log.csv", delimiter=",", names=True)
    assert table["t"][0] == pytest.approx(1.05, abs=1.1e-3)  # a sample
    np.testing.assert_allclose([table[f"w{a}"][0] for a in "xyz"], [-2.0, 1.0, -1.0])
    np.testing.assert_allclose([table[f"f{a}"][0] for a in "xyz"], [0.0, 9.81, 4.905], atol=1e-9)
    assert table["speed"][0] == pytest.approx(1e4 / 7 * 2 * np.pi / 60)
    late_s = throws.SLOW_REVOLUTIONS * 60.0 / 1e4  # an electrical turn lasts 6 ms
    np.testing.assert_allclose(table["t"] - table["t_wheel"], late_s, atol=1e-9)


def test_a_log_without_a_throw_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log_of(monkeypatch, np.zeros((10, 9)))
    with pytest.raises(DataError, match="does not turn"):
        throws.write_csv(tmp_path / "log", tmp_path / "log.csv")


def test_true_estimates_have_no_error_and_wrong_ones_theirs() -> None:
    """Made of the bodies, with a wheel that was taken for 2 % too light."""
    device = np.diag([8e-5, 2.5e-5, 9e-5])
    place, wheel, P = np.array([0.011, 0.002, 0.009]), 1.0 / 1.02, 1e-16 * np.eye(10)

    def found(body: throws.Body, wrong: float = 1.0) -> Found:
        mass, own = body.mass_kg + throws.DEVICE_KG, np.array([0.0, 0.0, 0.04])
        c = (throws.DEVICE_KG * place + body.mass_kg * own) / mass
        inertia = device + throws.moved(throws.DEVICE_KG, place - c)
        inertia = inertia + wrong * body.inertia_kg_m2 + throws.moved(body.mass_kg, own - c)
        about = wheel * inertia + throws.moved(mass, c)
        vector = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        return Found("log", "OK", np.concatenate([[mass], mass * c, vector]), P)

    alone = wheel * device + throws.moved(throws.DEVICE_KG, place)
    vector = alone[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    first = np.concatenate([[throws.DEVICE_KG], throws.DEVICE_KG * place, vector])
    sets = {
        "device_only": [Found("log", "OK", first, P)],
        "proof_body": [found(throws.proof_body())],
    }
    for name, places in throws.SETS.items():
        body = throws.frame_with_blocks(places)
        sets[name] = [found(body), found(body, 1.03), Found("log", "refused", np.empty(0), P)]
    for result in judged(sets):
        assert (result.throws, result.found, result.valid) == (3, 2, 2)
        assert result.worst_percent == pytest.approx(3.0, abs=1e-6)
        assert result.mean_percent == pytest.approx(1.5, abs=1e-6)


def test_throws_of_one_body_are_weighed_by_their_covariance() -> None:
    """Two sigmas of 1 and 3: weights 0.9 and 0.1; three times as far apart as they may be."""
    first, second = np.full(10, 1.0), np.full(10, 2.0)
    throws_of_one = [
        Found("a", "OK", first, np.eye(10)),
        Found("b", "OK", second, 9.0 * np.eye(10)),
    ]
    mean, P = pooled([*throws_of_one, Found("c", "refused", np.empty(0), np.empty(0))])
    np.testing.assert_allclose(mean, 1.1)
    np.testing.assert_allclose(P, 0.9 * np.eye(10), atol=1e-12)
    apart = [
        Found("a", "OK", first, 0.01 * np.eye(10)),
        Found("b", "OK", second, 0.09 * np.eye(10)),
    ]
    square = 10 * (0.1**2 / 0.01 + 0.9**2 / 0.09)
    np.testing.assert_allclose(pooled(apart)[1], 0.009 * square / 9 * np.eye(10), atol=1e-12)


def test_a_log_that_cannot_be_read_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Parser:
        @staticmethod
        def load(_path: str) -> None:
            raise IndexError("index out of range")

    monkeypatch.setitem(sys.modules, "orangebox", SimpleNamespace(Parser=Parser))
    with pytest.raises(DataError, match=r"LOG\.BFL: cannot be read: index out of range"):
        throws.write_csv(tmp_path / "LOG.BFL", tmp_path / "log.csv")
