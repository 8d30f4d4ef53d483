"""Load certificate as XML: Digital Calibration Certificate 3.3.0 of PTB, quantities in D-SI.

Namespaces https://ptb.de/dcc and https://ptb.de/si; documentation https://ptb.de/dcc/v3.3.0/. Required entries that
were not stated (laboratory, customer, place) are written as "not stated", the country as ZZ (ISO 3166-1: reserved for
users). The file is not signed; the responsible laboratory adds a signature.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from datetime import date
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

from drives.printable import one_line
from gateway import __version__
from gateway.result.certificate import (
    COVERAGE_FACTOR,
    COVERAGE_PROBABILITY,
    NOT_STATED,
    NOT_TRACEABLE,
    Certificate,
    CertifiedLoad,
    certificate,
)
from gateway.result.drawn import Drawn
from gateway.result.origin import PROGRAM, DriveOrigin
from gateway.result.result import to_dict

if TYPE_CHECKING:
    from gateway.result.result import Result

SCHEMA_VERSION: Final = "3.3.0"
DCC: Final = "https://ptb.de/dcc"
DSI: Final = "https://ptb.de/si"
#: Unit of the result -> the same in D-SI.
UNITS: Final = {
    "kg": r"\kilogram",
    "m": r"\metre",
    "kg m2": r"\kilogram\metre\tothe{2}",
    "deg C": r"\degreecelsius",
    "m/s2": r"\metre\second\tothe{-2}",
}
_LANGUAGE: Final = "en"
_DAY: Final = re.compile(r"\d{4}-\d\d-\d\d")
#: Packages whose files are the software that a certificate names.
_PACKAGES: Final = ("gateway", "drives")


def certificate_xml(result: Result, label: str | None, issued: date) -> str:
    """Return the XML certificate of one load, or of all loads, of a result.

    A refused load is listed without a value, with the reason.

    Parameters
    ----------
    result : Result
    label : str or None
        A load of the result.
    issued : date
    """
    register_namespace("dcc", DCC)
    register_namespace("si", DSI)
    stated, data = certificate(result, label), result.data or Drawn()
    checksum = result.sha256 or str(to_dict(result)["sha256"])
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": SCHEMA_VERSION})
    _administrative(_add(root, "administrativeData"), stated, data, checksum, issued)
    results = _add(root, "measurementResults")
    for load in stated.loads:
        _result(_add(results, "measurementResult"), load, result, stated)
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def software_sha256() -> str:
    """Return the checksum of the program: SHA-256 of the sorted names and contents of its files."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for name, file in sorted(_files(files(package), package)):
            content = file.read_bytes()
            digest.update(f"{name}\0{len(content)}\0".encode())
            digest.update(content)
    return digest.hexdigest()


def _files(folder: Traversable, name: str) -> Iterable[tuple[str, Traversable]]:
    for each in folder.iterdir():
        if each.is_dir() and each.name != "__pycache__":
            yield from _files(each, f"{name}/{each.name}")
        elif each.is_file():
            yield f"{name}/{each.name}", each


def _add(parent: Element, name: str, text: str | None = None, **attributes: str) -> Element:
    child = SubElement(parent, f"{{{DCC}}}{name}", attributes)
    if text is not None:
        child.text = one_line(text)
    return child


def _text(parent: Element, name: str, text: str) -> Element:
    """Return an element with text in one language."""
    element = _add(parent, name)
    _add(element, "content", text, lang=_LANGUAGE)
    return element


def _administrative(ring: Element, stated: Certificate, data: Drawn, checksum: str, issued: date) -> None:
    """Write program, dates of the measurement if recorded (else of the analysis or issue), persons and statements."""
    software = _add(_add(ring, "dccSoftware"), "software")
    _text(software, "name", PROGRAM)
    _add(software, "release", __version__)
    _add(software, "type", "application")
    _text(software, "description", f"sha256 of the program's files: {software_sha256()}")
    core = _add(ring, "coreData")
    _add(core, "countryCodeISO3166_1", "ZZ")
    _add(core, "usedLangCodeISO639_1", _LANGUAGE)
    _add(core, "mandatoryLangCodeISO639_1", _LANGUAGE)
    _add(core, "uniqueIdentifier", f"{PROGRAM}-{checksum[:32]}")
    _identify(_add(core, "identifications"), [("sha256 of the result file", checksum, "other")])
    made = [source.created for source in data.sources if source.created] or [data.created or ""]
    days = sorted(found[0] for text in made if (found := _DAY.match(text))) or [issued.isoformat()]
    _add(core, "beginPerformanceDate", days[0])
    _add(core, "endPerformanceDate", days[-1])
    _add(core, "performanceLocation", "other")
    _add(core, "issueDate", issued.isoformat())
    items = _add(ring, "items")
    for load in stated.loads:
        item = _add(items, "item")
        _text(item, "name", f"load {load.label}")
        _identify(_add(item, "identifications"), [("label of the load", load.label, "other")])
    _contact(_add(_add(ring, "calibrationLaboratory"), "contact"))
    responsible = _add(_add(ring, "respPersons"), "respPerson")
    _text(_add(responsible, "person"), "name", data.operator or NOT_STATED)
    _add(responsible, "mainSigner", "true")
    _contact(_add(ring, "customer"))
    traced, statements = stated.traceability, _add(ring, "statements")
    statement = _add(statements, "statement")
    _text(statement, "name", "metrological traceability" if traced.is_traceable else NOT_TRACEABLE)
    _add(statement, "traceable", "true" if traced.is_traceable else "false")
    _text(statement, "declaration", traced.statement if traced.is_traceable else f"{NOT_TRACEABLE}: {traced.statement}")
    for load in stated.refused:
        refusal = _add(statements, "statement")
        _text(refusal, "name", f"load {load.label}: refused")
        _text(refusal, "declaration", f"no value is certified: {load.refused}")
        _add(refusal, "valid", "false")


def _contact(contact: Element) -> None:
    _text(contact, "name", NOT_STATED)
    _text(_add(contact, "location"), "further", NOT_STATED)


def _identify(parent: Element, entries: Iterable[tuple[str, str, str]]) -> None:
    """Return identification elements of (name, value, issuer)."""
    for name, value, issuer in entries:
        identification = _add(parent, "identification")
        _add(identification, "issuer", issuer)
        # leading, trailing or no characters at all are refused by the schema
        _add(identification, "value", one_line(value) or "-")
        _text(identification, "name", name)


def _result(parent: Element, load: CertifiedLoad, result: Result, stated: Certificate) -> None:
    data = result.data or Drawn()
    _text(parent, "name", f"load {load.label}")
    _text(parent, "description", f"on the arm of {result.robot}; frame {load.frame}")
    method = _add(_add(parent, "usedMethods"), "usedMethod")
    how = result.method or "diagnosis of effects"
    _text(method, "name", f"load identification from joint torque, method {how}")
    _text(
        method,
        "description",
        f"expanded uncertainty U = k u, coverage factor k = {COVERAGE_FACTOR:g}, normal distribution",
    )
    _add(method, "norm", "JCGM 100:2008")
    software = _add(_add(parent, "usedSoftware"), "software")
    name, _, release = (data.software or PROGRAM).rpartition(" ")
    _text(software, "name", name or release)
    _add(software, "release", release if name else NOT_STATED)
    if data.drives:
        equipment = _add(parent, "measuringEquipments")
        for drive in data.drives:
            _drive(_add(equipment, "measuringEquipment"), drive)
    conditions = _add(parent, "influenceConditions")
    if result.bare is not None and result.bare.gravity_m_s2:
        condition = _add(conditions, "influenceCondition")
        _text(condition, "name", "acceleration of gravity used")
        _real(_add(_add(condition, "data"), "quantity"), "m/s2", math.hypot(*result.bare.gravity_m_s2))
    for axis, *range_c in stated.temperatures:
        condition = _add(conditions, "influenceCondition")
        _text(condition, "name", f"temperature of motor or drive {axis}")
        measured = _add(condition, "data")
        for name, value in zip(("lowest", "highest"), range_c, strict=True):
            quantity = _add(measured, "quantity")
            _text(quantity, "name", name)
            _real(quantity, "deg C", value)
    ambient = _add(conditions, "influenceCondition")
    _text(ambient, "name", "ambient temperature")
    _text(_add(ambient, "data"), "text", "not recorded")
    results = _add(parent, "results")
    certified = _add(results, "result")
    _text(certified, "name", f"load {load.label} in the frame {load.frame}")
    values = _add(certified, "data")
    if load.refused:
        _text(values, "text", f"refused, no value is certified: {load.refused}")
    for each in () if load.refused else load.quantities:
        quantity = _add(values, "quantity", refType="basic_measuredValue")
        _text(quantity, "name", each.name)
        if math.isfinite(each.value):
            _real(quantity, each.unit, each.value, each.expanded)
        else:
            _text(quantity, "noQuantity", "the data do not determine it")
    if load.budget:
        _budget(_add(results, "result"), load)
    sources = [source for source in data.sources if source.sha256]
    checksums = _add(parent, "measurementMetaData") if sources else parent
    for source in sources:
        entry = _add(checksums, "metaData")
        _text(entry, "name", f"{source.kind} {source.file}")
        _text(entry, "declaration", f"sha256 {source.sha256}")


def _drive(parent: Element, drive: DriveOrigin) -> None:
    _text(parent, "name", f"drive of J{drive.joint}" + (f", {drive.name}" if drive.name else ""))
    known = [
        (name, str(value), "manufacturer")
        for name, value in (
            ("vendor id", drive.vendor_id),
            ("product code", drive.product_code),
            ("serial number", drive.serial_number),
            ("hardware version", drive.hardware_version),
        )
        if value is not None
    ]
    _identify(_add(parent, "identifications"), [("node id", str(drive.node_id), "other"), *known])
    if drive.software_version:
        firmware = _add(_add(parent, "installedSoftware"), "software")
        _text(firmware, "name", "firmware")
        _add(firmware, "release", one_line(drive.software_version) or "-")
        _add(firmware, "type", "firmware")


def _budget(parent: Element, load: CertifiedLoad) -> None:
    _text(parent, "name", f"uncertainty budget of the mass of load {load.label}")
    _text(parent, "description", "standard uncertainty by source; type A and B: kind of evaluation (JCGM 100, 3.3.4)")
    listed = _add(_add(parent, "data"), "list")
    for line in load.budget:
        quantity = _add(listed, "quantity")
        _text(quantity, "name", line.source)
        _text(quantity, "description", f"type {line.evaluation}, {100 * line.share:.1f} % of the variance")
        _real(quantity, "kg", line.std_kg)


def _real(quantity: Element, unit: str, value: float, expanded: float | None = None) -> None:
    """Return a D-SI number, with its expanded uncertainty if known."""
    real = SubElement(quantity, f"{{{DSI}}}real")
    _leaves(real, {"value": repr(value), "unit": UNITS[unit]})
    if expanded is None:
        return
    uncertainty = SubElement(SubElement(real, f"{{{DSI}}}measurementUncertaintyUnivariate"), f"{{{DSI}}}expandedMU")
    _leaves(
        uncertainty,
        {
            "valueExpandedMU": repr(expanded),
            "coverageFactor": repr(COVERAGE_FACTOR),
            "coverageProbability": repr(COVERAGE_PROBABILITY),
            "distribution": "normal",
        },
    )


def _leaves(parent: Element, values: Mapping[str, str]) -> None:
    for name, text in values.items():
        SubElement(parent, f"{{{DSI}}}{name}").text = text
