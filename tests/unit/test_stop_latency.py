"""The table of stops: the worst of the jobs of each wire, on rows made by hand."""

from __future__ import annotations

from study.stop_latency import Row, worst


def test_a_wire_has_the_stops_of_its_jobs_together_and_the_largest_of_each_time() -> None:
    rows = [
        Row("CANopen", "move", 3, (0.001, 0.009), None),
        Row("CANopen", "homing", 4, (0.002, 0.005), None),
        Row("Modbus", "move", 5, (0.004, 0.006), 1),
        Row("Modbus", "homing", 6, (0.003, 0.007), 2),
    ]
    assert [row.line() for row in worst(rows)] == [
        "| CANopen | 2 | 7 | 2.0 ms | 9.0 ms |  |",
        "| Modbus | 2 | 11 | 4.0 ms | 7.0 ms | 2 |",
    ]
