"""One example for the help text of every command; a test parses every example."""

EXAMPLES = {
    "list": "ground list RUN_BATCH",
    "tc": "ground tc RUN_BATCH method=FUSED unknown=TARGET last_s=60 --timeout 300",
    "number": "ground --key uplink.key number",
    "history": "ground history --count 5",
    "tm": "ground tm estimate --field target_mass_kg --count 10",
    "playback": "ground playback HOUSEKEEPING --from 1000 --to 2000 --out range.bin",
    "sequence": "ground sequence 3 steps.txt --start",
    "fetch-assets": "ground fetch-assets",
    "serve": "ground serve --recordings recordings --http-port 8080",
}
FILES = {
    "get": "ground file get recordings/recording_0001.mcap",
    "put": "ground file put noise.yaml",
    "list": "ground file list recordings",
    "transfers": "ground file transfers",
    "resume": "ground file resume",
    "cancel": "ground file cancel 7",
    "rename": "ground file rename files/noise.yaml files/old.yaml",
    "mkdir": "ground file mkdir files/tables",
    "rm": "ground file rm files/old.yaml",
    "free": "ground file free",
}
