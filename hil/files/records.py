"""`hil records`: list, inspect, merge and export measurement records, and an axis's history with its trend."""

from __future__ import annotations

import argparse
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import replace_file
from hil.correction.formats import wide_iso
from hil.figures.history import (
    FoundCampaign,
    Moment,
    Pass,
    find_campaigns,
    history,
    merge,
    read_campaign,
    read_pass,
    trend,
    usual_pass,
)
from hil.figures.iso230 import Iso230
from hil.figures.reading import RULE
from hil.files.resume_hints import resume_command, state_of
from hil.records.files import naming
from hil.records.journal import CHAINED, check_rows
from hil.records.rows import read_csv, to_csv
from hil.ui.terminal.output import Align, from_here, number, print_facts, print_table, write_json


# -- list and inspect --------------------------------------------------------------------------------------------------
def run_list(args: argparse.Namespace) -> int:
    campaigns = find_campaigns(args.places)
    rows = [
        [
            "–" if one.begun is None else one.begun.strftime("%Y-%m-%d %H:%M"),
            one.axis,
            one.kind,
            str(len(one.passes)),
            str(sum(_rows(part) for part in one.passes)),
            from_here(one.directory),
            state_of(one) or "–",
        ]
        for one in campaigns
    ]
    heads: list[str | tuple[str, Align]] = ["begun", ("axis", "left"), ("kind", "left"), "passes", "rows"]
    if rows:
        print_table([*heads, ("campaign", "left"), ("state", "left")], rows, paths="campaign")
    else:
        print(f"no campaign below {', '.join(map(str, args.places))}")
    for one in campaigns:
        if said := resume_command(one).sentence():
            print(f"{from_here(one.directory)}: {said}")
    if args.json:
        write_json(args.json, {"campaigns": [_campaign_form(one) for one in campaigns]})
    return 0


def run_inspect(args: argparse.Namespace) -> int:
    campaign = read_campaign(Path(args.campaign))
    instrument = campaign.purpose.get("instrument")
    facts = {"axis": campaign.axis, "kind": campaign.kind}
    if isinstance(instrument, dict):
        facts["instrument"] = str(instrument.get("kind", "?"))
    print_facts(facts)
    columns: list[str | tuple[str, Align]] = ["pass", ("begun", "left"), "rows", "runs", "A", "R", "B"]
    print_table([*columns, ("unchanged", "left")], [_pass_row(one) for one in campaign.passes])
    notes = [(one.name, note) for one in campaign.passes for note in one.notes if not _BEGUN.fullmatch(note)]
    for name, note in notes:
        print(f"{name}: {_read_aloud(note)}")
    if any(RULE in note for _, note in notes):
        print(RULE)
    if said := resume_command(campaign).sentence():
        print(f"unfinished, {said}")
    chain, good = _chain(campaign)
    print(f"rows: {chain}")
    if args.json:
        write_json(args.json, {**_campaign_form(campaign), "chain": chain, "chain_good": good})
    bad = [
        one
        for one in campaign.passes
        if one.state in ("changed", "torn") or (one.records is None and not one.only_begun)
    ]
    return 1 if bad or good is False else 0


_BEGUN = re.compile(rf"begun \S+({CHAINED})?")  # in the table
_DIGEST = re.compile(r"\b([0-9a-f]{16})[0-9a-f]{48}\b")


def _read_aloud(note: str) -> str:
    """A note of a pass for people: digests by their first 16 digits, the rule of readings left out once for all, µm."""
    return _DIGEST.sub(r"\1…", note.replace(f" ({RULE})", "").replace(" um", " µm"))


def _chain(campaign: FoundCampaign) -> tuple[str, bool | None]:
    """The result of checking the chain, in words, and whether the rows are as they were written; None without a
    chain.
    """
    try:
        found = check_rows(campaign.directory)
    except InputError as error:
        return f"NO: {error}", False
    if found is None:
        return "not chained: whether they were changed is not known", None
    left = "".join(f"; the last line of {name} was not confirmed, resuming drops it" for name in found.unconfirmed)
    return f"unchanged ({sum(found.lines.values())} lines held against rows.chain){left}", True


def _pass_row(one: Pass) -> list[str]:
    figures = one.figures()
    values = figures.figures() if isinstance(figures, Iso230) else {}
    state = {"closed": "yes", "changed": "NO: changed since", "open": "never closed", "torn": "NO: torn"}[one.state]
    runs = "–" if one.records is None else str(len(one.records.runs))
    begun = one.begun.strftime("%Y-%m-%d %H:%M") + ("" if one.dated else " (file)")
    return [one.name, begun, str(_rows(one)), runs, *(number(values.get(name)) for name in ("A", "R", "B")), state]


def _rows(one: Pass) -> int:
    return 0 if one.records is None else len(one.records)


def _campaign_form(campaign: FoundCampaign) -> dict[str, Any]:
    way = resume_command(campaign)
    return {
        "directory": str(campaign.directory),
        "axis": campaign.axis,
        "kind": campaign.kind,
        "purpose": dict(campaign.purpose),
        "state": state_of(campaign),
        "resume": way.command,
        "refused": way.refused,
        "passes": [
            {
                "name": one.name,
                "begun": one.begun.isoformat(timespec="seconds"),
                "dated": one.dated,
                "rows": _rows(one),
                "why": one.why,
                "state": one.state,
                "sha256": one.sha256,
                "notes": list(one.notes),
            }
            for one in campaign.passes
        ],
    }


# -- merge and export --------------------------------------------------------------------------------------------------
def run_merge(args: argparse.Namespace) -> int:
    found = [read_pass(Path(path), None) for path in args.records]
    for one in found:
        if one.records is None:
            raise InputError(one.why, path=one.path)
    merged = merge(sorted(found, key=lambda one: one.begun.timestamp()))
    origin = "merged from " + ", ".join(f"{one.path.name} {one.sha256[:16]}" for one in found)
    replace_file(args.out, to_csv(merged, origin).encode())
    facts = {"rows": len(merged), "runs": len(merged.runs), "files": len(found)}
    print_facts({"records": f"{facts['rows']} rows, {facts['runs']} runs of {len(found)} files", "written": args.out})
    if args.json:
        write_json(args.json, {"written": args.out, **facts})
    return 0


def run_export(args: argparse.Namespace) -> int:
    records = read_csv(args.records)
    if args.format == "json":
        columns = {name: [None if math.isnan(v) else v for v in records[name].tolist()] for name in records.columns}
        write_json(args.out, {"columns": columns})
    else:
        with naming(args.records):
            settings = wide_iso.WideIsoSettings(cells=args.cells, decimal=args.decimal)
            text = to_csv(records) if args.format == "csv" else wide_iso.dump(records, settings)
        replace_file(args.out, text.encode())
    print_facts({"records": f"{len(records)} rows", "written": args.out})
    if args.json:
        write_json(args.json, {"written": args.out, "format": args.format, "rows": len(records)})
    return 0


# -- history -----------------------------------------------------------------------------------------------------------
def run_history(args: argparse.Namespace) -> int:
    names = args.figure or ["A", "R", "B"]
    campaigns = [one for one in find_campaigns(args.places) if args.axis in (None, one.axis)]
    moments = history(campaigns, names)
    found = {one.at.name for one in moments}
    passes = args.passes or ([usual_pass(moments)] if moments else [])
    moments = [one for one in moments if one.at.name in passes]
    if not moments:
        raise InputError(f"no pass below {', '.join(args.places)} has the figures {', '.join(names)}")
    axes = sorted({one.campaign.axis for one in moments})
    if len(axes) > 1:
        raise InputError(f"these are several axes ({', '.join(axes)}), expected one: --axis NAME")
    print_table(
        ["begun", ("campaign", "left"), ("pass", "left"), *names, "°C"], [_moment_row(one, names) for one in moments]
    )
    if others := sorted(found - set(passes)):
        print(f"shown: passes named {', '.join(passes)}; others, for --pass: {', '.join(others)}")
    days = np.array([one.at.begun.timestamp() / 86400.0 for one in moments])
    trends = {name: trend(days, np.array([one.figures_um[name] for one in moments])) for name in names}
    for name, line in trends.items():
        if line is not None:
            print(f"{name}: {line.slope_um:+.2f} ± {2 * line.std_um:.2f} µm (k = 2) in 30 days")
    if args.out or args.png:
        from hil.ui.report.history import history_image, render_history  # noqa: PLC0415  (plots are slow to import)

        if args.out:
            replace_file(args.out, render_history(f"Axis {axes[0]} over time", moments, names).encode())
            print(args.out)
        if args.png:
            replace_file(args.png, history_image(moments, names))
            print(args.png)
    if args.json:
        forms = [
            {"begun": m.at.begun.isoformat(timespec="seconds"), "pass": str(m.at.path), **m.figures_um} for m in moments
        ]
        slopes = {name: None if line is None else vars(line) for name, line in trends.items()}
        write_json(args.json, {"axis": axes[0], "moments": forms, "per_30_days": slopes})
    return 0


def _moment_row(moment: Moment, names: list[str]) -> list[str]:
    begun = moment.at.begun.strftime("%Y-%m-%d %H:%M") + ("" if moment.at.dated else " (file)")
    values = [number(moment.figures_um[name]) for name in names]
    return [begun, moment.campaign.directory.name, moment.at.name, *values, number(moment.mean_temp_c, 1)]
