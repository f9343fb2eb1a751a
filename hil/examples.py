"""One example for the help of every command; a test parses every example."""

EXAMPLES = {
    "run": "hil run world.yaml --config robot.yaml --fast --seed 1 --out runs/first",
    "seeds": "hil seeds target_leo --config robot.yaml --first 100 --count 10",
    "list": "hil list",
    "schema": "hil schema sensors.imu",
    "vcan": "hil vcan -- ip -br link",
    "vs-basilisk": "hil vs-basilisk --make-env target_leo --seeds 3",
}
