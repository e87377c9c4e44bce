"""A certificate as a Digital Calibration Certificate: PTB's DCC 3.2.1 with values in the D-SI 2.1.0. No I/O.

Elements and their order are those of PTB's schema `dcc.xsd` (namespace https://ptb.de/dcc, LGPL-3) and of `SI_Format.xsd`
(https://ptb.de/si). The result is checked here for what the schema demands and the types of `Certificate` do not ensure:
no empty text, a unit of the D-SI, a finite number. Tests hold the files against the schema itself, where it is on the computer.

Each figure is a quantity with two words as `refType`: `basic_measuredValue` for what was measured or `basic_parameter` for targets,
and the figure's own, such as `hil_A`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from importlib.metadata import version
from xml.etree import ElementTree as ET

from drivers.errors import InputError
from hil.axis.certificate import Device, Party
from hil.figures.uncertainty import CONFORMITY_RULE, Conformity
from hil.report.certificate import NOT_RECORDED, SIMULATED, UNITS, Certificate, Stated

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
SCHEMA_VERSION = "3.2.1"
COVERAGE_FACTOR, COVERAGE_PROBABILITY = 2.0, 0.95
CONFORMITY = {
    (Conformity.PASS, True): "pass",
    (Conformity.FAIL, False): "fail",
    (Conformity.UNDECIDED, True): "conditionalPass",
    (Conformity.UNDECIDED, False): "conditionalFail",
}
"""(decision, value within the limit) -> the schema's word. Undecided is split as in ILAC-G8:09/2019, 4.2.3."""


def to_xml(certificate: Certificate) -> bytes:
    """The certificate as XML, UTF-8.

    Raises InputError for a mandatory text that is empty, a unit unknown to the D-SI, and a value that is not finite.
    """
    for prefix, namespace in (("dcc", DCC), ("si", SI)):
        ET.register_namespace(prefix, namespace)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA_VERSION})
    _administrative(root, certificate)
    results = _add(root, "measurementResults")
    _result(_add(results, "measurementResult"), certificate)
    ET.indent(root, " ")
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"


def _add(parent: ET.Element, name: str, text: str | None = None, **attributes: str) -> ET.Element:
    """A child in the DCC's namespace. Raises InputError for a text of blanks alone: the schema has no empty ones."""
    child = ET.SubElement(parent, f"{{{DCC}}}{name}", attributes)
    if text is not None:
        if not text.strip():
            raise InputError(f"the certificate's {name} is empty, which a DCC does not allow")
        child.text = " ".join(text.split())
    return child


def _named(parent: ET.Element, name: str, text: str) -> ET.Element:
    child = _add(parent, name)
    _add(child, "content", text, lang="en")
    return child


def _contact(parent: ET.Element, name: str, party: Party) -> None:
    contact = _add(parent, name)
    _named(contact, "name", party.name)
    if party.email:
        _add(contact, "eMail", party.email)
    location = _add(contact, "location")
    _add(location, "city", party.city)
    _add(location, "countryCode", party.country)
    for key, text in (("postCode", party.post_code), ("street", party.street)):
        if text:
            _add(location, key, text)


def _identified(parent: ET.Element, issuer: str, value: str, name: str) -> None:
    one = _add(parent, "identification")
    _add(one, "issuer", issuer)
    _add(one, "value", value)
    _named(one, "name", name)


def _software(parent: ET.Element) -> None:
    """This program. PTB's rules of good practice want a letter before the numbers of a release."""
    software = _add(parent, "software")
    _named(software, "name", "hil")
    _add(software, "release", f"v{version('hil')}")
    _add(software, "type", "application")


def _administrative(root: ET.Element, certificate: Certificate) -> None:
    config = certificate.config
    data = _add(root, "administrativeData")
    _software(_add(data, "dccSoftware"))

    core = _add(data, "coreData")
    _add(core, "countryCodeISO3166_1", config.laboratory.country)
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", certificate.number)
    _add(core, "beginPerformanceDate", certificate.begun.isoformat())
    _add(core, "endPerformanceDate", certificate.ended.isoformat())
    _add(core, "performanceLocation", config.place)
    _add(core, "issueDate", certificate.issued[:10])

    items = _add(data, "items")
    for title, device, extra in (
        (
            f"{'simulated ' if certificate.simulated else ''}machine, axis {certificate.axis}",
            config.machine,
            certificate.axis,
        ),
        ("drive", config.drive, ""),
    ):
        item = _add(items, "item")
        _named(item, "name", title)
        _device(item, device)
        identifications = _add(item, "identifications")
        _identified(identifications, "manufacturer", device.serial, "serial number")
        if extra:
            _identified(identifications, "owner", extra, "axis")

    laboratory = _add(data, "calibrationLaboratory")
    _contact(laboratory, "contact", config.laboratory)
    responsible = _add(_add(data, "respPersons"), "respPerson")
    _named(_add(responsible, "person"), "name", config.person)
    _add(responsible, "mainSigner", "true")
    _contact(data, "customer", config.customer)
    statements = _add(data, "statements")
    if certificate.simulated:
        statement = _add(statements, "statement", refType="hil_simulated")
        _named(statement, "name", "simulated machine")
        _named(statement, "declaration", SIMULATED)
    for note in (f"Decisions by {CONFORMITY_RULE}.", *certificate.notes, *config.notes):
        _named(_add(statements, "statement"), "declaration", note)
    for name, digest in certificate.files.items():
        statement = _add(statements, "statement", refType="hil_recordsHash")
        _named(statement, "name", f"SHA-256 of {name}")
        _named(statement, "declaration", digest)


def _device(parent: ET.Element, device: Device) -> None:
    if device.maker:
        _named(_add(parent, "manufacturer"), "name", device.maker)
    _add(parent, "model", device.model)


def _result(result: ET.Element, certificate: Certificate) -> None:
    _named(result, "name", certificate.title)
    _named(result, "description", certificate.sentence)
    method = _add(_add(result, "usedMethods"), "usedMethod", refType="basic_calibrationMethod")
    _named(method, "name", f"{certificate.standard}, {certificate.clauses}")
    _named(method, "description", certificate.method)
    _add(method, "norm", certificate.standard)
    _software(_add(result, "usedSoftware"))
    _equipment(result, certificate)
    conditions = _add(result, "influenceConditions")
    if not certificate.conditions:  # PTB's rules do not accept a certificate that is silent about them
        condition = _add(conditions, "influenceCondition")
        _named(condition, "name", "environment")
        _named(_add(condition, "data"), "text", NOT_RECORDED)
    else:
        for name, (unit, low, high) in certificate.conditions.items():
            condition = _add(conditions, "influenceCondition", refType=_ref(name))
            _named(condition, "name", name)
            data = _add(condition, "data")
            for suffix, value in (("min", low), ("max", high)):
                quantity = _add(data, "quantity", refType=f"basic_{suffix}")
                _named(quantity, "name", f"{name}, {suffix}")
                _real(quantity, value, unit)
    results = _add(result, "results")
    figures = _add(results, "result", refType="hil_figures")
    _named(figures, "name", "Figures")
    data = _add(figures, "data")
    for one in certificate.stated:
        _quantity(data, one)
    if certificate.series is not None:
        series = _add(results, "result", refType="hil_series")
        _named(series, "name", certificate.series.name)
        rows = _add(_add(series, "data"), "list", refType="basic_tableContent")
        for index, (name, (unit, values)) in enumerate(certificate.series.columns.items()):
            kind = "basic_parameter" if index == 0 else "basic_measuredValue"
            quantity = _add(rows, "quantity", refType=f"{kind} {_own(name)}")
            _named(quantity, "name", name)
            _real_list(quantity, values.tolist(), unit)


def _equipment(result: ET.Element, certificate: Certificate) -> None:
    device = certificate.config.instrument
    equipment = _add(_add(result, "measuringEquipments"), "measuringEquipment", refType="basic_measurementStandard")
    _named(equipment, "name", "instrument")
    dates = {"calibrated": device.calibrated, "due": device.due, "certificate": device.certificate}
    told = "; ".join(f"{name} {value}" for name, value in dates.items() if value)
    _named(
        equipment,
        "description",
        "; ".join(part for part in (certificate.setup.get("Instrument", ""), told) if part) or device.model,
    )
    _device(equipment, device)
    _identified(_add(equipment, "identifications"), "manufacturer", device.serial, "serial number")


def _quantity(data: ET.Element, one: Stated) -> None:
    quantity = _add(data, "quantity", refType=f"basic_measuredValue {_own(one.symbol)}")
    _named(quantity, "name", one.symbol)
    _named(quantity, "description", one.meaning)
    _real(quantity, one.value, one.unit, one.expanded)
    if one.limit is not None and one.verdict is not None:
        statement = _add(_add(quantity, "measurementMetaData"), "metaData", refType="basic_conformity")
        _named(statement, "name", f"{one.symbol} against its limit")
        _add(statement, "norm", "ISO 14253-1")
        _named(statement, "declaration", f"{one.verdict}: {CONFORMITY_RULE}")
        if one.verdict is not Conformity.UNDECIDED or one.expanded:  # without U even "conditional" would be a claim
            _add(statement, "conformity", CONFORMITY[one.verdict, abs(one.value) <= one.limit])
        limit = _add(_add(statement, "data"), "quantity", refType="basic_upperSpecificationLimit")
        _real(limit, one.limit, one.unit)


def _si(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, f"{{{SI}}}{name}").text = text


def number(value: float) -> str:
    """A decimal number of the D-SI, which reads back as the same float. Raises InputError for one that is not finite."""
    if not math.isfinite(value):
        raise InputError(f"a value of the certificate is {value}, expected a finite number")
    return repr(float(value))


def unit_of(unit: str) -> str:
    """The unit in the form of the D-SI. Raises InputError for one that is not in `UNITS`."""
    if unit not in UNITS:
        raise InputError(f"{unit!r} is no unit of a certificate, expected one of {', '.join(UNITS)}")
    return UNITS[unit]


def _real(parent: ET.Element, value: float, unit: str, expanded: float | None = None) -> None:
    real = ET.SubElement(parent, f"{{{SI}}}real")
    _si(real, "value", number(value))
    _si(real, "unit", unit_of(unit))
    if expanded is not None:
        spread = ET.SubElement(real, f"{{{SI}}}expandedUnc")
        _si(spread, "uncertainty", number(expanded))
        _si(spread, "coverageFactor", number(COVERAGE_FACTOR))
        _si(spread, "coverageProbability", number(COVERAGE_PROBABILITY))
        _si(spread, "distribution", "normal")


def _real_list(parent: ET.Element, values: Sequence[float], unit: str) -> None:
    real = ET.SubElement(parent, f"{{{SI}}}realListXMLList")
    _si(real, "valueXMLList", " ".join(map(number, values)))
    _si(real, "unitXMLList", unit_of(unit))


def _own(name: str) -> str:
    """The type of a quantity in this program's namespace. No id: by PTB's rules of good practice one is there to be referred to."""
    return f"hil_{_ref(name)}"


def _ref(name: str) -> str:
    """A name as an XML identifier."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", name)
