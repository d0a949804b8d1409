"""What else the machine was doing, and whether it is fit to time anything."""

from __future__ import annotations

from math import inf, isnan, nan
from pathlib import Path

import psutil
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.machine import doctor
from harness.machine.awake import awake
from harness.machine.unrest import Reading, Unrest, between, read, stalled

QUIET = Unrest(2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 1.0)
NOTHING = Unrest()
PSI = "some avg10={} avg60=0.00 avg300=0.00 total=5500000\nfull avg10=0.00 total=0\n"


def put(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_what_happened_between_two_readings() -> None:
    before = Reading(10.0, 1.0, 0.0, 4.0, 100.0, 7.0, 512.0, 3000.0)
    after = Reading(12.0, 1.5, 0.0, 4.4, 104.0, 307.0, 4608.0, 2400.0)
    found = between(before, after)
    assert found == Unrest(2.0, 0.25, 0.0, pytest.approx(0.1), 150.0, 4096.0, 0.8)
    assert len(found.reasons()) == 5  # all but memory
    assert found.told()["pressure"] == "25.0%"


def test_what_is_not_known_is_unavailable_and_no_reason() -> None:
    assert QUIET.is_quiet and NOTHING.is_quiet and not NOTHING.reasons()
    assert set(NOTHING.told().values()) == {"unavailable"}
    blind = Reading(10.0, nan, nan, nan, nan, nan, nan, nan)
    assert all(isnan(value) for value in between(blind, blind._replace(time=11.0))[1:])


def test_what_a_counter_is_too_coarse_for_is_no_reason() -> None:
    short = Unrest(0.2, 0.0, 0.0, 0.05, 49.0, 0.0, 1.0)  # one tick of two cores, and ten switches
    assert short.is_quiet
    assert len(short._replace(seconds=2.0, switches=51.0).reasons()) == 2


def test_pressure_is_read_where_the_system_has_it(tmp_path: Path) -> None:
    assert isnan(stalled(tmp_path, "cpu"))
    put(tmp_path, {"proc/pressure/cpu": PSI.format("3.00"), "proc/pressure/memory": "odd"})
    assert stalled(tmp_path, "cpu") == pytest.approx(5.5)
    assert isnan(stalled(tmp_path, "memory"))


def test_a_system_that_does_not_tell_gives_no_zeros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*_: object) -> None:
        raise psutil.AccessDenied

    monkeypatch.setattr(psutil.Process, "num_ctx_switches", refuses)
    monkeypatch.setattr(psutil, "swap_memory", refuses)
    monkeypatch.setattr(psutil, "cpu_freq", lambda: None)
    reading = read(root=tmp_path)
    for name in ("pressure", "memory", "switches", "swapped", "frequency"):
        assert isnan(getattr(reading, name)), name


def test_two_readings_of_this_machine() -> None:
    first = read()
    second = read()
    assert second.time > first.time
    for value in between(first, second):
        assert isnan(value) or value >= 0.0


# The doctor


@pytest.mark.parametrize(
    ("check", "files", "level", "word"),
    [
        (doctor.frequency, {}, "unknown", "unavailable"),
        (doctor.frequency, {"{cpu}/cpufreq/scaling_governor": "performance\n"}, "good", "perform"),
        (doctor.frequency, {"{cpu}/cpufreq/scaling_governor": "powersave"}, "wrong", "powersave"),
        (doctor.sleep, {}, "unknown", "unavailable"),
        (doctor.sleep, {"dev/cpu_dma_latency": "0000"}, "good", "awake"),
        (doctor.pressure, {}, "unknown", "unavailable"),
        (doctor.pressure, {"proc/pressure/cpu": PSI.format("0.50")}, "good", "0.5 %"),
        (doctor.pressure, {"proc/pressure/cpu": PSI.format("99.64")}, "wrong", "99.6 %"),
        (doctor.heat, {}, "unknown", "unavailable"),
        (doctor.heat, {"{cpu}/thermal_throttle/core_throttle_count": "0"}, "good", "no processor"),
        (doctor.heat, {"{cpu}/thermal_throttle/core_throttle_count": "12"}, "wrong", "12 times"),
        (doctor.cores, {"sys/fs/cgroup/cpu.max": "5000 100000"}, "wrong", "limited to 0.05"),
        (doctor.memory, {"sys/fs/cgroup/memory.max": "1000000000"}, "wrong", "1.0 GB"),
        (
            doctor.memory,
            {
                "sys/fs/cgroup/memory.max": "8000000000",
                "sys/fs/cgroup/memory.stat": "anon 7500000000\nfile 400000000\n",
            },
            *("wrong", "0.5 GB"),
        ),
    ],
)
def test_what_the_doctor_says(
    check: doctor.Callable[[Path], doctor.Finding],
    files: dict[str, str],
    level: str,
    word: str,
    tmp_path: Path,
) -> None:
    cpu = "sys/devices/system/cpu/cpu0"
    put(tmp_path, {name.format(cpu=cpu): text for name, text in files.items()})
    finding = check(tmp_path)
    assert finding.level == level and word in finding.said
    assert (finding.remedy == "") == (level == "good")


def test_limits_of_both_kinds_of_control_group(tmp_path: Path) -> None:
    assert doctor.cpu_quota(tmp_path) == inf
    old = put(tmp_path / "old", {"sys/fs/cgroup/cpu/cpu.cfs_quota_us": "150000",
                                 "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000"})  # fmt: skip
    assert doctor.cpu_quota(old) == 1.5
    assert doctor.cpu_quota(put(tmp_path / "free", {"sys/fs/cgroup/cpu.max": "max 1"})) == inf


def test_the_command_says_what_is_wrong_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    good = doctor.Finding("swap", "good", "not in use")
    bad = doctor.Finding("load", "wrong", "3.00", "end other programs")
    blind = doctor.Finding("heat", "unknown", "unavailable", "watch it")
    for found, code in (([good, blind], 0), ([good, bad], 1)):
        monkeypatch.setattr(doctor, "examine", lambda found=found: found)
        result = CliRunner().invoke(app, ["doctor"])
        assert result.exit_code == code
    assert "WRONG" in result.stdout and "→ end other programs" in result.stdout


def test_every_check_has_an_answer_here() -> None:
    found = doctor.examine()
    assert len({finding.topic for finding in found}) == len(found) == 12
    assert all(finding.said for finding in found)


def test_processors_are_kept_awake_as_long_as_the_file_is_open(tmp_path: Path) -> None:
    device = tmp_path / "cpu_dma_latency"
    with awake(device) as kept:
        assert not kept  # there is none: nothing is made
    assert not device.exists()
    device.write_bytes(b"\xff" * 4)
    with awake(device) as kept:
        assert kept and device.read_bytes() == bytes(4)
    with awake(tmp_path) as kept:  # nobody may write to a folder
        assert not kept
