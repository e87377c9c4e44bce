"""Figures of parameter downloads on a simulated bus at 1 Mbit/s: frames against the least there can be, time against the prediction
made before, many drives against what the bus alone would take, and all of it against a plain loop over the canopen package.

Everything is in simulated time, so the figures are the same on every host. The bus counts its bits itself and shares nothing with
the prediction.
"""

from __future__ import annotations

import queue
from pathlib import Path
from typing import Any

import can
import canopen
import pytest
from support.bench import Record, row
from support.parameter_rigs import ParameterRig, maker_eds, maker_keys, maker_set

from drivers.raw_parameters import WireTime
from hil.parameters.download import download
from hil.parameters.preflight import Prediction, match_set, predict, seconds_together
from hil.parameters.report import Ending
from hil.parameters.set_file import ParameterSet
from hil.parameters.transaction import Target

COUNT = 300
EACH = 100  # on each of eight nodes: the ratios are those of 300, in a third of the time
TURNAROUND_S = 0.001
NODES = tuple(range(1, 9))


@pytest.fixture(scope="module")
def eds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return maker_eds(tmp_path_factory.mktemp("eds"), COUNT)


def _predicted(rig: ParameterRig, contents: ParameterSet) -> list[Prediction]:
    found = []
    for drive in rig.drives:
        wanted, objections = match_set(drive, contents)
        assert not objections
        found.append(predict(drive, wanted))
    return found


class Measured:
    """Frames and times of one download by the stages in which it was made."""

    def __init__(self, rig: ParameterRig, contents: ParameterSet) -> None:
        self.wire, self.clock = rig.bench.wire, rig.bench.clock
        self.marks: dict[str, list[tuple[int, int, int]]] = {}
        begun = self._now()
        targets = [Target(drive, contents, journal) for drive, journal in zip(rig.drives, rig.journals, strict=True)]
        self.reports = download(targets, progress=lambda stage, *_: self._mark(stage))
        self.whole = self._since(begun)
        end_of_look = self.marks["look"][-1]
        self.write = self._since(end_of_look)

    def _now(self) -> tuple[int, int, int]:
        return self.wire.frames, self.wire.busy_ns, self.clock.now_ns()

    def _mark(self, stage: str) -> None:
        self.marks.setdefault(stage, []).append(self._now())

    def _since(self, then: tuple[int, int, int]) -> tuple[int, float, float]:
        frames, busy_ns, now_ns = self._now()
        return frames - then[0], (busy_ns - then[1]) * 1e-9, (now_ns - then[2]) * 1e-9


def test_300_parameters_on_one_node(eds: Path, tmp_path: Path, record_property: Record) -> None:
    contents = maker_set(COUNT)
    rig = ParameterRig(eds, tmp_path)
    prediction = _predicted(rig, contents)[0]
    found = Measured(rig, contents)
    assert found.reports[0].ending is Ending.WRITTEN
    assert rig.values(maker_keys(COUNT)) == [entry.raw for entry in contents.entries]
    least_write = 4 * COUNT  # a request and an answer each, to write and to read back
    least_whole = 6 * COUNT  # nothing can be known to differ before it was read once
    frames, busy_s, _ = found.write
    all_frames, all_busy_s, all_s = found.whole
    ratios = {
        "frames_write": frames / least_write,
        "frames_whole": all_frames / least_whole,
        "wire_write": busy_s / prediction.write.seconds,
        "time_whole": all_s / prediction.whole.seconds,
    }
    row(
        record_property,
        "300 parameters to one drive, written and read back",
        frames,
        least_write,
        "frames",
        beside="a request and an answer each",
        asked="≤ 1.05",
    )
    row(
        record_property,
        "300 parameters to one drive, with a look before",
        all_frames,
        least_whole,
        "frames",
        beside="the same, three times each",
        asked="≤ 1.05",
    )
    predicted_ms = [1e3 * prediction.write.seconds, 1e3 * prediction.whole.seconds]
    row(
        record_property,
        "300 parameters to one drive, wire time",
        1e3 * busy_s,
        predicted_ms[0],
        "ms",
        beside="predicted",
    )
    row(
        record_property,
        "300 parameters to one drive, the whole job",
        1e3 * all_s,
        predicted_ms[1],
        "ms",
        beside="predicted",
    )
    print(f"wire busy {1e3 * all_busy_s:.2f} ms in the whole job")
    assert ratios["frames_write"] <= 1.05
    assert ratios["frames_whole"] <= 1.05
    assert 111 / 135 <= ratios["wire_write"] <= 1.0, "an upper bound: frames without a stuff bit have 111 of 135 bits"
    assert 111 / 135 <= ratios["time_whole"] <= 1.1


@pytest.mark.parametrize("share", [1.0, 0.3, 0.0])
def test_only_what_differs_is_written(eds: Path, tmp_path: Path, share: float) -> None:
    contents = maker_set(COUNT)
    rig = ParameterRig(eds, tmp_path)
    keys = maker_keys(COUNT)
    held = round(COUNT * (1 - share))
    for key, entry in zip(keys[:held], contents.entries, strict=False):
        rig.bench.slave.dictionary.set_number(*key, entry.raw)
    found = Measured(rig, contents)
    differing = COUNT - held
    assert rig.values(keys) == [entry.raw for entry in contents.entries]
    print(f"\n{differing} of {COUNT} differ: {found.write[0]} frames after looking, {found.whole[0]} in all")
    assert found.write[0] == 4 * differing
    assert found.whole[0] <= 1.05 * (2 * COUNT + 4 * differing) + 15


# -- many nodes, and the plain loop --------------------------------------------------------------------------------------
class PlainNetwork(canopen.Network):
    """The canopen package on a simulated bus: after each of its requests time runs on until the answer is there."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus)
        self._asked = False

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        super().send_message(can_id, data, remote)
        node = self.nodes.get(can_id - 0x600)
        while node is not None and node.sdo.responses.empty():
            message = self.bus.recv(1.0)
            if message is None:
                raise queue.Empty
            self.notify(message.arbitration_id, message.data, message.timestamp)


def _plain_loop(eds: Path, folder: Path, contents: ParameterSet) -> float:
    """Seconds that `node.sdo[...].raw = value` and reading it back take, parameter by parameter, node by node."""
    rig = ParameterRig(eds, folder, nodes=NODES, turnaround_s=TURNAROUND_S)
    network = PlainNetwork(rig.bench.port())
    nodes = [network.add_node(node, str(eds)) for node in NODES]
    start_ns = rig.bench.clock.now_ns()
    for node in nodes:
        for (index, subindex), entry in zip(maker_keys(EACH), contents.entries, strict=True):
            node.sdo[index][subindex].raw = entry.raw
            assert node.sdo[index][subindex].raw == entry.raw
    return (rig.bench.clock.now_ns() - start_ns) * 1e-9


def test_eight_nodes_at_once(eds: Path, tmp_path: Path, record_property: Record) -> None:
    contents = maker_set(EACH)
    rig = ParameterRig(eds, tmp_path / "ours", nodes=NODES, turnaround_s=TURNAROUND_S)
    predictions = _predicted(rig, contents)
    found = Measured(rig, contents)
    for node in range(len(NODES)):
        assert rig.values(maker_keys(EACH), node) == [entry.raw for entry in contents.entries]
    _, busy_s, write_s = found.write
    _, all_busy_s, all_s = found.whole
    plain_s = _plain_loop(eds, tmp_path / "plain", contents)
    most_s = seconds_together([each.whole for each in predictions], TURNAROUND_S)
    frames = sum((each.whole for each in predictions), WireTime()).frames
    figures = {
        "bus_limit_write": write_s / busy_s,
        "bus_limit_whole": all_s / all_busy_s,
        "faster_write": plain_s / write_s,
        "faster_whole": plain_s / all_s,
        "predicted": all_s / most_s,
    }
    what = f"{EACH} parameters to each of 8 drives"
    row(record_property, f"{what}, written and read back", write_s, busy_s, "s", beside="the bus alone", asked="≤ 1.3")
    row(record_property, f"{what}, the whole job", all_s, all_busy_s, "s", beside="the bus alone", asked="≤ 1.3")
    row(
        record_property,
        f"{what}, written and read back",
        write_s,
        plain_s,
        "s",
        beside="a plain loop over canopen",
        asked="≤ 0.25",
    )
    print(f"predicted at most {most_s:.4f} s ({frames} frames)")
    assert all(report.ending is Ending.WRITTEN for report in found.reports)
    assert figures["bus_limit_write"] <= 1.3
    assert figures["bus_limit_whole"] <= 1.3
    assert figures["faster_write"] >= 4.0
