"""`fsw calibrate` on simulated recordings: every figure is compared with the true error."""

from evidence.declaration import declared, seeds, several

COMMAND = declared(
    "calibration",
    "fsw calibrate against wrong sensors",
    "hil calibration --scenario bench_target --count 20 --out runs/calibration",
    "evidence.calibration.command:run",
    several("--scenario", ("target_leo", "table_target", "bench_target"), "this one"),
    *seeds(20, "object"),
)
