"""Tables are dives: the same columns from every format, and no damage that goes unnoticed."""

import resource
import struct
import zipfile
from contextlib import suppress
from pathlib import Path
from time import process_time

import msgspec
import numpy as np
import pytest
from made_tables import FORMATS, HARMS, SECTIONS, recorded, settings, tables_of, write_tables
from scipy.io import loadmat, savemat
from table_bombs import TABLE_BOMBS, zeros

from insdvl_replay.core.config import Config, Dvl, Imu, Reference
from insdvl_replay.core.dive_columns import Dive
from insdvl_replay.core.errors import ConfigError, LogError
from insdvl_replay.inspection.survey import inspect_log
from insdvl_replay.logs import read_dive
from insdvl_replay.logs.formats.array_files import read_matlab
from insdvl_replay.logs.formats.readers import open_reader
from insdvl_replay.logs.formats.recording import open_recording
from insdvl_replay.preparation.replay import replay_log

NEEDS = {"parquet": "pyarrow"}
IMU = Imu(topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz")
DVL = Dvl(topic="dvl.csv", velocity="vx, vy, vz")


def write_pair(folder: Path, time_of: str = "{:.3f}", title: str = "t") -> Path:
    """Write an IMU of 100 Hz and a DVL of 5 Hz as CSV."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(1)
    for name, names, rate_hz, mean in (
        ("imu", "ax,ay,az,gx,gy,gz", 100.0, [0.0, 0.0, -9.8, 0.0, 0.0, 0.0]),
        ("dvl", "vx,vy,vz", 5.0, [1.0, 0.0, 0.0]),
    ):
        rows = rng.normal(mean, 0.01, (int(10 * rate_hz), len(mean)))
        lines = [
            ",".join([time_of.format(i / rate_hz), *map(repr, row)])
            for i, row in enumerate(rows.tolist())
        ]
        (folder / f"{name}.csv").write_text("\n".join([f"{title},{names}", *lines, ""]))
    return folder


def codes(dive: Dive) -> set[str]:
    return {note.code for note in dive.notes}


def same(dive: Dive, other: Dive) -> bool:
    """Whether two dives have the same numbers, to nine digits of their size."""
    for role in SECTIONS:
        one, two = getattr(dive, role), getattr(other, role)
        for name, values in vars(one).items():
            if name in ("look_d", "altitude_m"):  # what messages tell of beams, and tables do not
                continue
            expected = getattr(two, name)
            if (values is None) != (expected is None):
                return False
            if values is None:
                continue
            if values.shape != expected.shape:
                return False
            size = max(float(np.nanmax(np.abs(expected), initial=0.0)), 1e-12)
            if values.dtype.kind == "i":
                if not np.array_equal(values, expected):
                    return False
            elif not np.allclose(values, expected, rtol=0.0, atol=1e-10 * size, equal_nan=True):
                return False
    return True


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Dive]:
    return recorded(tmp_path_factory.mktemp("log"))


@pytest.mark.parametrize("ending", FORMATS)
def test_every_format_gives_the_dive_of_the_log(
    log: tuple[Path, Dive], tmp_path: Path, ending: str
) -> None:
    if ending in NEEDS:
        pytest.importorskip(NEEDS[ending])
    path, topics = write_tables(tmp_path / "dive", tables_of(log[1]), ending)
    dive = read_dive(path, settings(topics))
    assert same(dive, log[1])
    assert dive.name == "dive"
    assert codes(dive) <= {"joined_files", "file_clock_unconfirmed"}


@pytest.mark.parametrize("ending", FORMATS)
def test_results_are_those_of_the_log(log: tuple[Path, Dive], tmp_path: Path, ending: str) -> None:
    if ending in NEEDS:
        pytest.importorskip(NEEDS[ending])
    path, topics = write_tables(tmp_path / "dive", tables_of(log[1]), ending)
    of_tables = settings(topics)
    of_log = Config(evaluation=of_tables.evaluation, dvl=Dvl(beam_tilt_deg=30.0))
    ours, theirs = replay_log([path], of_tables), replay_log([log[0]], of_log)
    for mine, other in zip(ours.histories, theirs.histories, strict=True):
        np.testing.assert_allclose(mine.position, other.position, rtol=1e-9)
        np.testing.assert_allclose(mine.velocity_n, other.velocity_n, rtol=1e-9, atol=1e-9)


def test_a_log_and_a_table_are_one_dive(log: tuple[Path, Dive], tmp_path: Path) -> None:
    tables = {name: table for name, table in tables_of(log[1]).items() if name == "reference"}
    folder, topics = write_tables(tmp_path / "dive", tables, "csv")
    reference = settings({"imu": "", "dvl": "", **topics}).reference
    dive = read_dive([log[0], folder / "reference.csv"], Config(reference=reference))
    assert same(dive, log[1])


@pytest.mark.parametrize(
    ("stamp", "title", "form"),
    [
        (None, "t", "{:.3f}"),
        ("t [s]", "t", "{:.3f}"),
        ("100 Hz", "number", "{:.3f}"),
        ("1", "no", "{:.3f}"),
    ],
)
def test_times_come_from_a_column_or_a_rate(
    tmp_path: Path, stamp: str | None, title: str, form: str
) -> None:
    folder = write_pair(tmp_path / "dive", form, title)
    dvl_stamp = "5 Hz" if stamp == "100 Hz" else stamp
    config = Config(
        imu=Imu(
            topic="imu.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz", stamp=stamp
        )
    )
    dive = read_dive(
        folder,
        Config(imu=config.imu, dvl=Dvl(topic="dvl.csv", velocity="vx, vy, vz", stamp=dvl_stamp)),
    )
    np.testing.assert_array_equal(dive.imu.time_ns, 10_000_000 * np.arange(1000))
    np.testing.assert_array_equal(dive.dvl.time_ns, 200_000_000 * np.arange(50))
    assert ("table_without_times" in codes(dive)) == (title != "t")
    assert "tables_from_0" in codes(dive)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("named", [True, False])
def test_the_unit_of_times_is_that_of_the_title_or_of_the_rate(
    tmp_path: Path, unit: str, factor: float, named: bool
) -> None:
    folder = write_pair(tmp_path / "dive", "{:.3f}", f"Time ({unit})" if named else "time")
    for path in folder.iterdir():
        head, *rows = path.read_text().splitlines()
        cells = [row.partition(",") for row in rows]
        text = "\n".join(
            [head, *(f"{float(time) * factor:.0f},{others}" for time, _, others in cells), ""]
        )
        path.write_text(text)
    dive = read_dive(folder, Config(imu=IMU, dvl=DVL))
    np.testing.assert_array_equal(dive.imu.time_ns, 10_000_000 * np.arange(1000))
    assert ("table_time_unit" in codes(dive)) != named


def test_dates_and_comments_and_quotes_are_read(tmp_path: Path) -> None:
    folder = write_pair(tmp_path / "dive")
    text = (folder / "dvl.csv").read_text().splitlines()
    dates = [
        f'"2024-01-01T00:00:{float(line.partition(",")[0]):09.6f}Z",{line.partition(",")[2]}'
        for line in text[1:]
    ]
    (folder / "dvl.csv").write_text(
        "\n".join([f"# {text[0].replace('t,', 'time,', 1)}", *dates, ""])
    )
    times = open_recording(folder / "dvl.csv").log_times()[0]
    assert str(times[0].astype("M8[ns]")) == "2024-01-01T00:00:00.000000000"
    np.testing.assert_array_equal(np.diff(times), 200_000_000)


def test_columns_of_one_title_and_other_encodings_of_text(tmp_path: Path) -> None:
    text = "Time [s];v;v;Höhe (m)\r\n" + "".join(f"{i};{i}.5;{i}.25;-1\r\n" for i in range(20))
    for name, encoding in (("a.csv", "utf-8-sig"), ("b.csv", "utf-16"), ("c.csv", "latin-1")):
        (tmp_path / name).write_bytes(text.encode(encoding))
        dive_file = open_recording(tmp_path / name)
        (channel,) = dive_file.channels
        (block,) = dive_file.blocks({channel.id})
        columns = open_reader(channel, ["v", "v_2", "4", "3"]).columns(block)
        assert [columns[path][7].tolist() for path in ("v", "v_2", "4", "3")] == [
            [7.5],
            [7.25],
            [-1.0],
            [7.25],
        ]
        assert not dive_file.notes


def rows_of(cells: int) -> str:
    return 3 * (",".join(["1.5"] * cells) + "\n")


@pytest.mark.parametrize(
    ("titles", "refused"),
    [
        (["time", "[" + 3000 * " " + "x", "b"], "title of column 2 has 3002 letters"),
        (["time", 60_000 * "[", "b"], "title of column 2 has 60000 letters"),
        ([f"c{number}" for number in range(20_000)], "has 20000 columns; 4096 are read"),
        (["a"] * 2000, ""),
        (["a_2", *(f"a_{number}" for number in range(3, 1000)), *["a"] * 1000], ""),
    ],
)
def test_strange_titles_take_no_long_time(tmp_path: Path, titles: list[str], refused: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(",".join(titles) + "\n" + rows_of(len(titles)))
    before_s = process_time()
    if refused:
        with pytest.raises(LogError, match=refused):
            open_recording(path)
    else:
        (channel,) = open_recording(path).channels
        assert len(dict(msgspec.json.decode(channel.schema_data))) == len(titles)
    assert process_time() - before_s < 5.0


def test_arrays_are_grouped_by_length_and_by_time(tmp_path: Path) -> None:
    path = tmp_path / "dive.npz"
    arrays = {
        "imu_t": np.arange(90) * 0.01,
        "imu_acc": np.ones((90, 3)),
        "dvl_t": np.arange(90) * 0.2,
    }
    np.savez(
        path,
        **arrays,
        dvl_v=np.ones((3, 90)),
        fix=np.ones((20, 7)),
        name="dive",
        empty=np.empty(0),
    )
    channels = {channel.topic: channel for channel in open_recording(path).channels}
    assert sorted(channels) == ["dive.npz/dvl", "dive.npz/fix", "dive.npz/imu"]
    assert channels["dive.npz/fix"].schema_text.count("column_") == 7


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    for name, content, sentence in (
        ("a.csv", b"hello\n", "is no table"),
        ("b.csv", b"", "is empty"),
        ("c.npz", b"PK\x03\x04 cut", "cannot be read as .npz"),
        ("d.mat", b"MATLAB 5.0 MAT-file, cut", "cannot be read as .mat"),
        (
            "e.npy",
            b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (3,)}",
            "cannot be read as",
        ),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(LogError, match=sentence):
            open_recording(tmp_path / name)


def test_settings_that_the_hint_for_tables_names_are_enough(tmp_path: Path) -> None:
    folder = write_pair(tmp_path)
    values = {"topic": "dvl.csv", "velocity": "vx, vy, vz"}
    with pytest.raises(LogError, match=r"has no DVL: no setting names a table") as raised:
        read_dive(folder, Config(imu=IMU))
    hint = raised.value.hint.partition("to name its fields: ")[2]
    assert hint == "dvl.topic with dvl.beam_velocity or dvl.velocity"
    named = {key: value for key, value in values.items() if f"dvl.{key}" in hint}
    assert len(read_dive(folder, Config(imu=IMU, dvl=Dvl(**named))).dvl.time_ns) == 50


@pytest.mark.parametrize(
    ("above", "left_out"),
    [
        ("Time [s],Vx [kn]", 0),
        ("Export of instrument 7\nRate: 100\nTime [s],Vx [kn]", 2),
        ("Device,DVL 7\nRate,100\nTime [s],Vx [kn]", 2),
        ("Device,\n,\nTime [s],Vx [kn]", 2),
        ("a;b;c\nsome words, and more, of it\nTime,Vx\ns,kn", 2),
        ("Time,Vx\n[s],[kn]", 0),
        ("Time [s],Vx [kn]\ndouble,double", 0),
    ],
)
def test_lines_above_the_names_of_the_columns_are_left_out(
    tmp_path: Path, above: str, left_out: int
) -> None:
    rows = "".join(f"{0.5 * i},{i + 1}.25\n" for i in range(30))
    (tmp_path / "dvl.csv").write_text(f"{above}\n{rows}")
    table = open_recording(tmp_path / "dvl.csv")
    (channel,) = table.channels
    (block,) = table.blocks({channel.id})
    assert open_reader(channel, ["vx"]).columns(block)["vx"][:2, 0].tolist() == [1.25, 2.25]
    assert channel.metadata == {"time": "s", "vx": "kn"}
    assert sum(note.count for note in table.notes if note.code == "table_header") == left_out


@pytest.mark.parametrize("member", ["xl/workbook.xml", "content.xml"])
def test_a_spreadsheet_is_named_whatever_its_ending(tmp_path: Path, member: str) -> None:
    for name in ("imu.xlsx", "imu.csv", "imu.npz", "imu.ods"):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr(member, "<sheet/>")
        with pytest.raises(LogError, match="is a spreadsheet") as raised:
            open_recording(tmp_path / name)
        assert "CSV" in raised.value.hint


# --- Files that say how large they are.


@pytest.mark.parametrize(
    ("name", "refused"),
    [
        ("10^6 long texts.parquet", "more than 67 MB of memory"),
        ("a page that lies.parquet", "more than 67 MB of memory"),
        ("60 MB of small zeros.mat", "more than 67 MB of memory"),
        ("10^9 cells.mat", "'imu' is of cells"),
        ("10^9 structures.mat", "'imu' is of structures"),
        ("3000 levels.mat", "is of structures"),
        ("10^9 claimed.npz", "cannot be read as .npz"),
        ("objects.npz", "cannot be read as .npz"),
    ],
)
def test_small_files_that_ask_for_much_are_refused(
    tmp_path: Path, name: str, refused: str
) -> None:
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    path = tmp_path / name
    path.write_bytes(TABLE_BOMBS[name]())
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(LogError, match=refused):
        open_recording(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 250_000


def test_matlab_files_give_what_scipy_reads(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    inner = {
        "acc": rng.normal(size=(50, 3)),
        "count": np.arange(50),
        "inside": {"valid": np.arange(50) % 2 == 0},
    }
    variables = {
        "imu": inner, "t": 0.5 * np.arange(50.0), "small": np.arange(50, dtype=np.int8), "name": "dive",
        "z": np.ones(50) * 1j, "parts": np.array([{"a": 1}, {"a": 2}]), "f32": np.float32(rng.random(50)),
    }  # fmt: skip
    for packed in (True, False):
        path = tmp_path / "dive.mat"
        savemat(path, variables, do_compression=packed)
        found = read_matlab(memoryview(path.read_bytes()))
        stored = loadmat(path, simplify_cells=True)
        known = {"imu.acc": stored["imu"]["acc"], "imu.count": stored["imu"]["count"]}
        known["imu.inside.valid"] = stored["imu"]["inside"]["valid"]
        known |= {name: stored[name] for name in ("t", "small", "f32")}
        assert set(found.arrays) == set(known)
        for name, expected in known.items():
            np.testing.assert_array_equal(found.arrays[name].squeeze(), expected)
            assert found.arrays[name].dtype.itemsize == expected.dtype.itemsize
        assert set(found.ignored) == {"z", "parts"}


def test_matlab_files_of_other_processors_are_read() -> None:
    def element(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    parts = [
        element(6, struct.pack(">II", 6, 0)),
        element(5, struct.pack(">ii", 2, 1)),
        struct.pack(">HH4s", 1, 1, b"t"),
    ]
    variable = element(14, b"".join([*parts, element(3, struct.pack(">hh", -2, 300))]))
    content = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(">H", 0x100) + b"MI" + variable
    np.testing.assert_array_equal(read_matlab(memoryview(content)).arrays["t"], [[-2], [300]])
    for end in (len(content) - 2, len(content) - len(variable) + 3):
        with pytest.raises(ValueError, match=r"cut|no variable"):
            read_matlab(memoryview(content[:end]))


def test_columns_of_parquet_that_are_no_numbers_are_named(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    columns = {
        "time [s]": pa.array([0.0, 0.1, None]), "acc": pa.array([[1.0, 2.0]] * 3), "on": pa.array([True, None, False]),
        "word": pa.array(["1,5", "2,5", "3,5"]), "whole": pa.array([1, None, 3]), "pose": pa.array([{"x": 1}] * 3),
        "stamp": pa.array([1_000_000, 2_000_000, 3_000_000], pa.timestamp("us", "Europe/Berlin")),
    }  # fmt: skip
    pytest.importorskip("pyarrow.parquet").write_table(pa.table(columns), tmp_path / "a.parquet")
    log_file = open_recording(tmp_path / "a.parquet")
    (channel,) = log_file.channels
    (block,) = log_file.blocks({channel.id})
    read = open_reader(channel, ["on", "word", "whole", "stamp"]).columns(block)
    assert {name: values[0].tolist() for name, values in read.items()} == {
        "on": [1.0], "word": [1.5], "whole": [1.0], "stamp": [1e9]
    }  # fmt: skip
    texts = {note.code: note.text for note in log_file.notes}
    assert "'acc' is of lists or structures, 'pose' is of lists" in texts["table_columns"]
    assert "table_no_time" in texts


def harmed(dive: Dive, folder: Path, seed: int) -> str:
    """Harm one table of a dive; say how it went: refused, noted, same, or what was silently different."""
    rng = np.random.default_rng(seed)
    harm = HARMS[seed % len(HARMS)]
    _, topics = write_tables(folder, tables_of(dive), "csv")
    path = folder / f"{rng.choice(SECTIONS)}.csv"
    path.write_text(harm(path.read_text().splitlines(), rng))
    try:
        found = read_dive(folder, settings(topics))
    except (LogError, ConfigError):
        return "refused"
    if same(found, dive):
        return "same"
    return (
        "noted"
        if codes(found) - {"joined_files"}
        else f"silent: {harm.__name__} of {path.name}, seed {seed}"
    )


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_table_is_refused_or_noted(
    log: tuple[Path, Dive], tmp_path: Path, seed: int
) -> None:
    assert not harmed(log[1], tmp_path / "dive", seed).startswith("silent")


@pytest.mark.nightly
def test_hundreds_of_damaged_tables_are_refused_or_noted(
    log: tuple[Path, Dive], tmp_path: Path
) -> None:
    found = [harmed(log[1], tmp_path / "dive", seed) for seed in range(300)]
    assert [outcome for outcome in found if outcome.startswith("silent")] == []
    assert {"refused", "noted"} <= set(found)


def mutant(content: bytes, rng: np.random.Generator) -> bytes:
    """Change bytes, cut, remove, insert or clear some."""
    data, place = bytearray(content), int(rng.integers(len(content)))
    match int(rng.integers(5)):
        case 0:
            for at in rng.integers(len(data), size=int(rng.integers(1, 20))).tolist():
                data[at] = int(rng.integers(256))
        case 1:
            del data[max(place, 1) :]
        case 2:
            del data[place : place + int(rng.integers(1, 300))]
        case 3:
            data[place:place] = rng.bytes(int(rng.integers(1, 100)))
        case _:
            data[place : place + 500] = bytes(len(data[place : place + 500]))
    return bytes(data) or b" "


@pytest.mark.nightly
@pytest.mark.parametrize("ending", FORMATS)
def test_changed_bytes_are_no_internal_error(
    log: tuple[Path, Dive], tmp_path: Path, ending: str
) -> None:
    if ending in NEEDS:
        pytest.importorskip(NEEDS[ending])
    path, topics = write_tables(tmp_path / "dive", tables_of(log[1]), ending)
    files = sorted((tmp_path / "dive").iterdir())
    for seed in range(60):
        rng = np.random.default_rng(seed)
        file = files[int(rng.integers(len(files)))]
        content = file.read_bytes()
        file.write_bytes(mutant(content, rng))
        with suppress(LogError, ConfigError):
            read_dive(path, settings(topics))
        with suppress(LogError):
            inspect_log(path, Config())
        file.write_bytes(content)


def test_rows_that_are_comments_are_counted(tmp_path: Path) -> None:
    folder = write_pair(tmp_path / "dive")
    head, *rows = (folder / "dvl.csv").read_text().splitlines()
    rows[0], rows[9] = f"# {rows[0]}", f"%{rows[9]}"
    (folder / "dvl.csv").write_text("\n".join(["# made by hand, in 2024", f"# {head}", *rows, ""]))
    dive = read_dive(folder, Config(imu=IMU, dvl=DVL))
    assert len(dive.dvl.time_ns) == 48
    assert [note.count for note in dive.notes if note.code == "table_comments"] == [2]


def test_a_quote_in_a_number_is_no_number(tmp_path: Path) -> None:
    folder = write_pair(tmp_path / "dive")
    head, *rows = (folder / "dvl.csv").read_text().splitlines()
    quoted = [",".join(f'"{cell}"' for cell in row.split(",")) for row in rows]
    rows[3], rows[7] = rows[3].replace(".", '."', 1), rows[7].replace(".", '."', 1)
    for lines, cells in ((quoted, 0), (rows, 2)):
        (folder / "dvl.csv").write_text("\n".join([head, *lines, ""]))
        dive = read_dive(folder, Config(imu=IMU, dvl=DVL))
        assert len(dive.dvl.time_ns) == 50 - cells
        assert sum(note.count for note in dive.notes if note.code == "table_cells") == cells


def test_an_error_holds_nothing_of_what_was_read(tmp_path: Path) -> None:
    """A run reads a file several times; each error held the arrays that were read before it."""
    path = tmp_path / "dive.mat"
    path.write_bytes(zeros(100_000_000))
    with pytest.raises(LogError, match="more than 67 MB") as raised:
        read_dive(path, Config())
    cause = raised.value.__cause__
    assert cause is not None
    assert cause.__traceback__ is None


def test_rows_of_other_sensors_in_one_table_hide_no_fix(tmp_path: Path) -> None:
    """A row that lacks the reference must not take the place of the fix that has the same time."""
    lines = ["time,ax,ay,az,gx,gy,gz,vx,vy,vz,lat,lon"]
    for row in range(3000):
        lines.append(f"{0.02 * row:.2f},0.1,0.0,-9.8,0.0,0.0,0.01,,,,,")
        if row % 10 == 0:
            lines.append(f"{0.02 * row:.2f},,,,,,,{1.0 + 0.01 * (row % 7):.2f},0.0,0.0,,")
        if row % 50 == 0:
            lines.append(f"{0.02 * row:.2f},,,,,,,,,,{32.0 + 1.7e-7 * row:.8f},34.0")
    log = tmp_path / "log.csv"
    log.write_text("\n".join([*lines, ""]))
    config = Config(
        imu=Imu(topic="log.csv", specific_force="ax, ay, az", angular_rate="gx, gy, gz"),
        dvl=Dvl(topic="log.csv", velocity="vx, vy, vz"),
        reference=Reference(topic="log.csv", latitude="lat", longitude="lon"),
    )
    read = read_dive(log, config)
    assert read.reference is not None
    assert len(read.reference.time_ns) == 60
    assert read.reference.has_position
    (empty,) = [note for note in read.notes if note.code == "reference_empty"]
    assert empty.count == 3300
