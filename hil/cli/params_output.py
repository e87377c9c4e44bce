"""How `hil params` prints what became of its jobs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivers.parameters import ParameterValue
from hil.cli.output import Align, print_table, write_json
from hil.params.report import JobReport, Row, Verdict, slow

_MOST_ROWS = 40  # of parameters that nothing became of


def shown(value: ParameterValue | None) -> str:
    """A value in a table's cell."""
    if value is None:
        return "–"
    if isinstance(value, bytes):
        return value.hex() or "empty"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def print_reports(reports: Sequence[JobReport], json: str | None) -> int:
    """All of it; the exit status."""
    for report in reports:
        _print(report)
    if json:
        write_json(json, {"good": all(each.good for each in reports), "drives": [each.as_json() for each in reports]})
    return 0 if all(each.good for each in reports) else 1


def _print(report: JobReport) -> None:
    counts = {verdict: sum(row.verdict is verdict for row in report.rows) for verdict in Verdict}
    told = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items() if count)
    print(f"{report.drive}: {report.ending.value}" + (f" ({told}; {report.seconds:.3f} s)" if told else ""))
    changed = [row for row in report.rows if row.verdict is not Verdict.SAME]
    if changed:
        columns: list[str | tuple[str, Align]] = [
            "address",
            ("name", "left"),
            "before",
            "set",
            ("unit", "left"),
            ("", "left"),
        ]
        print_table(columns, [_cells(row) for row in changed[:_MOST_ROWS]])
        if len(changed) > _MOST_ROWS:
            print(f"… and {len(changed) - _MOST_ROWS} more (--json FILE has all)")
    for objection in report.objections:
        print(f"{report.drive}: {objection}")
    for line in (report.error, *report.notes):
        if line:
            print(f"{report.drive}: {line}")
    if report.stored:
        print(f"{report.drive}: stored")
    if report.audited is not None:
        lost = f"{len(report.lost)} parameters differ after its restart: {', '.join(report.lost[:8])}"
        print(f"{report.drive}: " + ("after its restart it still holds all of it" if report.audited else lost))
    if report.journal:
        print(f"{report.drive}: `hil params resume` or `hil params rollback` finishes it ({report.journal})")
    _print_slow(report)


def _cells(row: Row) -> list[str]:
    return [row.address, row.name, shown(row.old), shown(row.new), row.unit, row.verdict.value]


def _print_slow(report: JobReport) -> None:
    for row in slow(report.rows)[:5]:
        times = [f"{kind} {1e3 * time:.1f} ms" for kind, time in (("read", row.read_s), ("write", row.write_s)) if time]
        print(f"{report.drive}: slow: {row.address} {row.name}, {', '.join(times)}")


def plain(value: ParameterValue | None) -> Any:
    """A value as JSON has it."""
    return value.hex() if isinstance(value, bytes) else value
