"""One example for the help of every command; a test parses every example."""

EXAMPLES = {
    "run": "hil run world.yaml --config robot.yaml --fast --seed 1 --out runs/first",
    "seeds": "hil seeds target_leo --config robot.yaml --first 100 --count 10",
    "faults": "hil faults --only torque_drift --lane virtual",
    "list": "hil list",
    "campaign": "hil campaign hil/evidence/campaign/examples/target.yaml --out runs/campaign",
    "vcan": "hil vcan -- ip -br link",
    "fuzz": "hil fuzz --inputs 1e6 --only stim300 --out runs/fuzz",
    "kills": "hil kills --count 20 --out runs/kills",
    "transfers": "hil transfers --count 20 --out runs/transfers",
    "alarms": "hil alarms --scenario target_leo --samples 100 --bytes 10 --out runs/alarms",
    "lies": "hil lies --only exact --every 10 --out runs/lies",
    "mistakes": "hil mistakes --case target --only 'prior wrong and tight'",
    "imported": "hil imported --motion poses --first 100 --count 10",
    "rough": "hil rough --case target --count 50 --out runs/rough",
    "differential": "hil differential --count 3",
    "soak": "hil soak --hours 2 --rate 50 --imu-rate 125 --out runs/soak",
    "calibration": "hil calibration --scenario bench_target --count 20 --out runs/calibration",
    "hardware": "hil hardware --data ~/recordings --fetch",
    "vs-basilisk": "hil vs-basilisk --make-env target_leo --seeds 3",
    "bench": "hil bench target_leo --rounds 3 --only alone",
}
STUDIES = {
    "methods": "hil study methods --quick --out runs/methods",
    "paper": "hil study paper --quick",
    "trivial-energy": "hil study trivial-energy",
    "effects": "hil study effects wheels_leo --count 20 --out runs/effects",
    "modes": "hil study modes panel_leo --runs runs/panel",
}
