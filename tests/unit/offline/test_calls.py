"""Texts about arrays name calls of the Python API, and nothing that only a command line has."""

from offline.calls import in_calls


def test_commands_and_flags_become_calls():
    texts = [
        "/tmp/x/samples.mcap: no window; fsw check CONFIG RECORDING says why",
        "use one side of it, --from or --to",
        "know the arm better (--reference EMPTY) or move more (fsw excite)",
        "add 0.02 s to its stamps (fsw import --shift imu=0.02)",
    ]
    assert in_calls({"notes": texts, "count": 2}, "/tmp/x/samples.mcap") == {
        "notes": [
            "samples: no window; fsw.check(samples, robot) says why",
            "use one side of it, from_s or to_s",
            "know the arm better (reference=) or move more (fsw.plan)",
            "add 0.02 s to its stamps (t_imu_s + 0.02)",
        ],
        "count": 2,
    }
