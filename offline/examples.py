"""One example call for the help of each command; a test parses every example."""

EXAMPLES = {
    "run": "fsw run robot.yaml",
    "replay": "fsw replay recording.mcap --from 10 --to 40 --json",
    "identify": "fsw identify recording.mcap --config robot.yaml --method fused --holdout 0.3",
    "excite": "fsw excite robot.yaml --limits limits.yaml --duration-s 60 --out plan.yaml",
    "ctl": "fsw ctl robot.yaml run-batch method=fused last_s=60",
    "install-service": "fsw install-service robot.yaml --user fsw",
    "init": "fsw init arm.urdf --tool gripper --unknown target --imu stim300 --out robot.yaml",
    "devices": "fsw devices",
    "schema": "fsw schema estimator",
    "export": "fsw export result.json --format urdf --out target.urdf",
    "check": "fsw check robot.yaml recording.mcap",
    "bench": "fsw bench --rounds 3 --seconds 5 --priority 50",
}
