"""Mistakes on the command line."""

from pathlib import Path

from as_text import Cases, spoken

from insdvl_replay.results.lake import require_lake

WRONG = (
    "",
    "rn",
    "fly",
    "study",
    "run",
    "run DIVE --tabel drift",
    "run DIVE --frce",
    "run DIVE --json",
    "run DIVE --html",
    "check gates.toml --junit",
    "DIVE",
    "DIVE --start 5",
    "taken/dive",
    "vehicle.toml",
    "compare DIVE DIVE",
    "figure DIVE error",
    "run taken/dive",
    "inspect taken/dive/report.json",
    "run vehicle.toml",
    "run gates.toml",
    "run DIVE -c dives.toml",
    "run DIVE -c DIVE",
    "check DIVE",
    "check vehicle.toml",
    "run DIVE --start 5000 --no-auto",
    "run DIVE --end -3 --no-auto",
    "run DIVE --starts 0",
    "run DIVE --starts few",
    "run DIVE --format xml",
    "run DIVE --preset phog",
    "run DIVE --set dvl.scle=1",
    "run DIVE --set filters.aidd.gate_probability=0.9",
    "run DIVE --set dvl.scale 1.01",
    "run DIVE --set imu.angular_rate_unit=deg",
    "run DIVE --set dvl.lever_arm_m=[300,-100,200]",
    "run DIVE --set dvl.mounting_rpy_deg=[0,0,7200]",
    "run DIVE --set initial.latitude_deg=3244.5",
    "run DIVE --set imu.topic=/imu/data",
    "run DIVE --set reference.topic=/odom",
    "run DIVE -o",
    "run DIVE --against dvl.scale",
    "run DIVE --against dvl.scale=1.0",
    "run DIVE --start 30 --end 10",
    "run empty_folder",
    "run photo.png",
    "run htp://example.org/dive.mcap",
    "compare thesis",
    "compare thesis nowhere",
    "plan DIVE",
    "explain imu_gravty",
    "check verdict.toml",
    "inspect DIVE --propose vehicle.toml",
    "run DIVE -c absent.toml",
    "run absent.mcap",
    "run text.mcap",
    "run DIVE -o taken",
    "run DIVE -o text.mcap",
    "run DIVE -o thesis",
    "run DIVE --table evidense",
    "inspect text.mcap",
    "inspect nowhere.mcap",
    "config --preset phog",
    "schema rapport",
    "simulate static",
    "simulate spiral -o new.mcap",
    "simulate static -o text.mcap",
    "simulate static -o new.mcap --outage 60",
    "simulate static -o new.mcap --lost-beam x:1:2",
    "simulate static -o new.mcap --imu quantum",
    "simulate static -o new.mcap --sensor depht=1",
    "simulate static -o new.mcap --sensor depth=1 --sensor depth=2",
    "calibrate DIVE --only arms",
    "calibrate DIVE --only ,",
    "calibrate DIVE --hold-out 2",
    "calibrate text.mcap",
    "study observability strait",
    "study montecarlo strait",
    "study window a/dive.mcap b/dive.mcap",
    "figure result",
    "figure result speed",
    "figure result error --width 5",
    "figure result sigma --states bx",
    "figure result error --states ba",
    "check absent.toml",
    "check code.toml",
    "run DIVE -c code.toml",
    "run DIVE --lake text.mcap",
    "run DIVE --lake thesis",
    "run DIVE --lake .",
    "run DIVE --revision v1",
    "run DIVE --lake lake --revision v1 --against dvl.scale=1.1",
    "lake compact absent",
    "lake compact thesis",
    "history thesis",
    "history empty_lake",
    "history empty_lake --quantity positon",
    "run DIVE --shard 3/2",
    "run DIVE --shard half",
    "run DIVE --shard 1/2 --one-dive",
    "run DIVE --shard 1/2 --against dvl.scale=1.1",
    "run DIVE --shard 1/2 --table pooled",
    "run DIVE --shard 1/2 --format json",
    "merge",
    "merge thesis",
)
CODE = '[filters.baseline]\naiding = ["velocity"]\n[filters.mine]\naiding = ["velocity", "told_code:Down"]\n'


VERDICT = """dives = ["dive.mcap"]
[[gate]]
name = "it helps"
table = "answers"
column = "verdict"
equals = "good"
"""


def said_by_commands(folder: Path) -> Cases:
    """Return what each wrong use ends with."""
    assert spoken(
        folder, "simulate", "straight", "-o", "dive.mcap", "--duration", "40"
    ).startswith("exit code 0")
    (folder / "text.mcap").write_text("this is no log")
    for name in ("taken", "thesis"):
        (folder / name / "dive").mkdir(parents=True)
    (folder / "taken" / "dive" / "report.json").write_text('{"tool": {"name": "insdvl-replay"}}')
    (folder / "thesis" / "dive" / "chapter1.tex").write_text("years of work")
    require_lake(folder / "empty_lake", ())
    (folder / "code.toml").write_text(CODE)
    (folder / "vehicle.toml").write_text("[dvl]\nscale = 1.0\n")
    (folder / "empty_folder").mkdir()
    (folder / "photo.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (folder / "verdict.toml").write_text(VERDICT)
    (folder / "gates.toml").write_text('[[gate]]\nname = "a gate"\n')
    (folder / "dives.toml").write_text('[[dive]]\npath = "dive.mcap"\n')
    for line in WRONG:
        said = spoken(folder, *("dive.mcap" if word == "DIVE" else word for word in line.split()))
        yield line or "no command", said
