"""Batch, recursion, report and export give the same reasons against one estimate."""

import json
from pathlib import Path

import pytest
import yaml

from fsw.__main__ import main

QUIET = {"torque_noise_nm": 1e-4, "position_noise_rad": 1e-9}
TOO_QUIET = {"joints": [{"name": f"joint{k}", **QUIET} for k in range(1, 8)]}


def joint_2(**wrong: float) -> dict:
    return {"joints": [{"name": f"joint{k}"} | (wrong if k == 2 else {}) for k in range(1, 8)]}


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    main([*arguments, "--json"])
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("overlay", "span", "expected"),
    [
        ({}, (), []),
        ({}, ("--to", "6"), ["TOO_FEW_BLOCKS"]),
        # a mismatch that too little excitation and too few windows must not hide
        (TOO_QUIET, ("--to", "8"), ["MODEL_MISMATCH", "TOO_FEW_BLOCKS"]),
        # grossly wrong: what the estimate says depends on how it was sought, the reason must not
        (joint_2(sign=1), (), ["MODEL_MISMATCH"]),
        (joint_2(zero_offset_rad=-0.2), (), ["MODEL_MISMATCH"]),  # 0.15 rad off
        # the prior of a sensor is contradicted, by 8 sigma, and nothing else is wrong
        (joint_2(torque_offset_nm=0.8), (), ["PRIOR_CONFLICT"]),
    ],
)
def test_the_same_reasons_everywhere(
    flown: Path, tmp_path: Path, capsys, overlay: dict, span: tuple, expected: list[str]
) -> None:
    path, page = str(flown / "recording.mcap"), tmp_path / "page.html"
    told = ["--config", str(flown / "flight.yaml"), *span]
    if overlay:
        (tmp_path / "overlay.yaml").write_text(yaml.safe_dump(overlay), encoding="utf-8")
        told += ["--overlay", str(tmp_path / "overlay.yaml")]
    batch = printed(capsys, "identify", path, *told)
    recursion = printed(capsys, "replay", path, *told)
    assert batch["reasons"] == recursion["reasons"]
    assert batch["status"] == (batch["reasons"] or ["OK"])[0]
    assert recursion["reason"] == (recursion["reasons"] or [""])[0]
    assert set(expected) <= set(batch["reasons"])
    assert batch["diagnosis"]["parameters"] == recursion["diagnosis"]["parameters"]

    main(["report", path, *told, "--out", str(page)])
    capsys.readouterr()
    verdict = f"NOT VALID: {', '.join(batch['reasons'])}" if batch["reasons"] else "VALID"
    assert f">{verdict}</div>" in page.read_text(encoding="utf-8")

    for found in (batch, recursion):
        result = tmp_path / "result.json"
        result.write_text(json.dumps(found), encoding="utf-8")
        body = json.loads(exported(capsys, str(result), "json"))
        assert (body["valid"], body["reasons"]) == (not batch["reasons"], batch["reasons"])
        assert json.loads(exported(capsys, str(result), "ros2"))["reason"] == ", ".join(
            batch["reasons"]
        )


def exported(capsys: pytest.CaptureFixture[str], result: str, kind: str) -> str:
    main(["export", result, "--format", kind])
    return capsys.readouterr().out
