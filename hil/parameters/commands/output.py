"""How `hil params` prints what became of its jobs."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.raw_parameters import WireTime
from hil.app.terminal.output import Align, print_table, write_json
from hil.parameters.predict import seconds_together
from hil.parameters.report import Ending, JobReport, Row, Verdict, shown, slow

_MOST_ROWS = 40  # of parameters that nothing became of


def print_reports(reports: Sequence[JobReport], json: str | None) -> int:
    """All of it; the exit status."""
    for report in reports:
        _print(report)
    if json:
        write_json(json, {"good": all(each.good for each in reports), "drives": [each.as_json() for each in reports]})
    return 0 if all(each.good for each in reports) else 1


def print_parameters(held: str, rows: Sequence[Sequence[str]], most: int) -> None:
    """Parameters with what they hold (or held), what the set says and what became of it, as a table; at most so many of them."""
    columns: list[str | tuple[str, Align]] = ["address", ("name", "left"), held, "set", ("unit", "left"), ("", "left")]
    print_table(columns, rows[:most])
    if len(rows) > most:
        print(f"… and {len(rows) - most} more (--json FILE has all)")


def _print(report: JobReport) -> None:
    counts = {verdict: sum(row.verdict is verdict for row in report.rows) for verdict in Verdict}
    told = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items() if count)
    print(f"{report.drive}: {report.ending.value}" + (f" ({told}; {report.seconds:.3f} s)" if told else ""))
    refused = report.ending is Ending.REFUSED  # then the reasons matter
    changed = [row for row in report.rows if row.verdict is not Verdict.SAME and not refused]
    if changed:
        print_parameters("before", [_cells(row) for row in changed], _MOST_ROWS)
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


def print_costs(who: str, what: str, costs: Sequence[WireTime], answer_s: float = 0.0) -> None:
    """What accesses cost on the bus, and how long they take."""
    total = sum(costs, WireTime())
    least, likely, most = seconds_together(costs, answer_s)
    print(
        f"{who}: {what} takes {total.frames} frames, {total.bits_likely} bits ({total.bits_least} without stuffing, at most"
        f" {total.bits_most}): {1e3 * likely:.1f} ms ({1e3 * least:.1f} to {1e3 * most:.1f})"
        + (
            f" with {1e3 * answer_s:.2f} ms of the drive's own for each answer"
            if answer_s
            else " and what the drives take to answer"
        )
    )
