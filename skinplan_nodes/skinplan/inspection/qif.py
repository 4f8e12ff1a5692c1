"""Results as QIF 3.0 (ISO 23952): the characteristics that the part file asks for, as measured.

Written with the standard library, which escapes; the schema itself is not needed for writing.
Lengths are in metres, places in the workpiece frame.
"""

import math
import re
import uuid
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from skinplan.errors import InputError
from skinplan.inspection.run_files import items, number, section
from skinplan.whole_file import whole_file

NAME = "results.qif"
_SPACE = "http://qifstandards.org/xsd/qif3"
# Documents of the same run have the same id.
_RUNS = uuid.UUID("6f1f9a52-93c2-5a0a-8b34-3a1f6f0f8c0d")
_NAMES = {
    "profile": "SurfaceProfile",
    "flatness": "Flatness",
    "sphere_diameter": "SphericalDiameter",
    "point": "PointProfile",
}
_STATES = {"pass": "PASS", "fail": "FAIL", "not_measured": "NOT_ANALYZED"}
_VERDICTS = {"pass": "PASS", "fail": "FAIL", "not_judged": "UNDEFINED"}
# The first number given: that of the standard on geometrical tolerances.
_STANDARD = "1"
# What XML 1.0 has no way to write.
_UNWRITABLE = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class _Document:
    """The tree, with numbers for everything that is referred to."""

    def __init__(self) -> None:
        self.root = ET.Element("QIFDocument", xmlns=_SPACE, versionQIF="3.0.0")
        self._last = 0

    def add(self, parent: ET.Element, path: str, text: object = None, **attributes: str) -> Any:
        """Adds nested elements (``a/b``), the last one with text and attributes."""
        for name in path.split("/"):
            parent = ET.SubElement(parent, name)
        parent.attrib.update({key: _clean(value) for key, value in attributes.items()})
        if text is not None:
            parent.text = _clean(str(text))
        return parent

    def number(self) -> str:
        self._last += 1
        return str(self._last)

    def close(self) -> bytes:
        self.root.set("idMax", str(self._last))
        ET.indent(self.root, " ")
        return bytes(ET.tostring(self.root, "utf-8", xml_declaration=True)) + b"\n"


def qif_document(summary: Mapping[str, Any]) -> bytes:
    """Returns the results of a run as QIF.

    Args:
        summary: The document ``summary.json`` with its section ``inspection``.
    """
    document = _Document()
    root, add = document.root, document.add
    job, found = section(dict(summary), "job"), section(dict(summary), "inspection")
    # The time of the inspection: written again, the document is the same.
    moment = str(found.get("made_at") or datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    add(root, "QPId", uuid.uuid5(_RUNS, str(job.get("id"))))
    add(root, "Version/TimeCreated", moment)
    header = add(root, "Header")
    add(header, "Application/Name", "skinplan")
    part = f"part {job.get('part')}, mesh {section(dict(summary), 'mesh').get('sha256')}"
    add(header, "Description", part)
    standard = add(add(root, "StandardsDefinitions", n="1"), "Standard", id=document.number())
    add(standard, "Organization/StandardsOrganizationEnum", "ISO")
    add(standard, "Designator", "1101")
    add(standard, "Year", "2017")
    units = add(root, "FileUnits/PrimaryUnits")
    for kind, name in (("AngularUnit", "radian"), ("LinearUnit", "meter")):
        unit = add(units, kind)
        add(unit, "SIUnitName", name)
        add(unit, "UnitName", name)
    rows = _asked(found)
    if rows:
        _definitions(document, rows)
    _results(document, rows, job, found, moment)
    return document.close()


def write_qif(folder: Path, summary: Mapping[str, Any]) -> Path:
    """Writes ``results.qif`` of a run in one step.

    Raises:
        InputError: It can't be written.
    """
    path = folder / NAME
    try:
        with whole_file(path) as temporary:
            temporary.write_bytes(qif_document(summary))
    except OSError as error:
        raise InputError(f"{path}: it can't be written ({error.strerror or error})") from error
    return path


class _Row:
    """One characteristic with the numbers of its elements."""

    def __init__(self, values: dict[str, Any]) -> None:
        self.values = values
        self.name = _NAMES[str(values["kind"])] + "Characteristic"
        self.item = self.measurement = self.feature = self.feature_measured = ""
        self.nominal = self.feature_nominal = ""

    @property
    def is_point(self) -> bool:
        return self.values["kind"] == "point" and math.isfinite(number(_place(self.values)[0]))


def _asked(found: dict[str, Any]) -> list[_Row]:
    rows = [row for row in items(found, "characteristics") if row.get("kind") in _NAMES]
    limit = number(section(found, "tolerance").get("deviation_max_m"))
    whole = section(found, "whole")
    if math.isfinite(limit):
        worst = abs(number(whole.get("worst_m")))
        # A zone of both sides about the nominal surface.
        rows.insert(
            0,
            {
                "id": "deviation",
                "kind": "profile",
                "tolerance_m": 2.0 * limit,
                "value_m": 2.0 * worst,
                "state": "not_measured"
                if not math.isfinite(worst)
                else "pass"
                if worst <= limit
                else "fail",
            },
        )
    return [_Row(row) for row in rows]


def _definitions(document: _Document, rows: Sequence[_Row]) -> None:
    points = [row for row in rows if row.is_point]
    if points:
        _features(document, points)
    count = str(len(rows))
    holder = document.add(document.root, "Characteristics")
    document.add(holder, "FormalStandardId", _STANDARD)
    defined = document.add(holder, "CharacteristicDefinitions", n=count)
    nominals = document.add(holder, "CharacteristicNominals", n=count)
    listed = document.add(holder, "CharacteristicItems", n=count)
    for row in rows:
        definition, nominal = document.number(), document.number()
        row.item = document.number()
        element = document.add(defined, row.name + "Definition", id=definition)
        tolerance = number(row.values.get("tolerance_m"))
        if row.values["kind"] == "sphere_diameter":
            zone = document.add(element, "Tolerance")
            document.add(zone, "MaxValue", _decimal(tolerance))
            document.add(zone, "MinValue", _decimal(-tolerance))
            document.add(zone, "DefinedAsLimit", "false")
        else:
            document.add(element, "ToleranceValue", _decimal(tolerance))
            if row.values["kind"] == "flatness":
                document.add(element, "MaterialCondition", "NONE")
        element = document.add(nominals, row.name + "Nominal", id=nominal)
        document.add(element, "CharacteristicDefinitionId", definition)
        if row.feature_nominal:
            document.add(element, "FeatureNominalIds", n="1")
            document.add(element[-1], "Id", row.feature_nominal)
        if row.values["kind"] == "sphere_diameter":
            document.add(element, "TargetValue", _decimal(number(row.values.get("nominal_m"))))
        element = document.add(listed, row.name + "Item", id=row.item)
        document.add(element, "Name", row.values["id"])
        if row.feature:
            document.add(element, "FeatureItemIds", n="1")
            document.add(element[-1], "Id", row.feature)
        document.add(element, "CharacteristicNominalId", nominal)


def _features(document: _Document, points: Sequence[_Row]) -> None:
    count = str(len(points))
    holder = document.add(document.root, "Features")
    definition = document.number()
    document.add(document.add(holder, "FeatureDefinitions", n="1"), "PointFeatureDefinition",
                 id=definition)  # fmt: skip
    nominals = document.add(holder, "FeatureNominals", n=count)
    listed = document.add(holder, "FeatureItems", n=count)
    for row in points:
        row.feature_nominal, row.feature = document.number(), document.number()
        element = document.add(nominals, "PointFeatureNominal", id=row.feature_nominal)
        document.add(element, "FeatureDefinitionId", definition)
        document.add(element, "Location", _triple(_place(row.values)))
        document.add(element, "Normal", _triple(row.values.get("normal")))
        element = document.add(listed, "PointFeatureItem", id=row.feature)
        document.add(element, "FeatureNominalId", row.feature_nominal)
        document.add(element, "FeatureName", row.values["id"])
        document.add(element, "DeterminationMode/Checked/CheckDetails/Measured")


def _results(
    document: _Document,
    rows: Sequence[_Row],
    job: dict[str, Any],
    found: dict[str, Any],
    moment: str,
) -> None:
    verdict = _VERDICTS.get(str(section(found, "verdict").get("state")), "NOT_MEASURED")
    holder = document.add(document.root, "Results")
    component, results = document.number(), document.number()
    element = document.add(
        document.add(holder, "MeasurementResultsSet", n="1"), "MeasurementResults", id=results
    )
    points = [row for row in rows if row.is_point and row.values["state"] != "not_measured"]
    if points:
        measured = document.add(element, "MeasuredFeatures", n=str(len(points)))
        for row in points:
            row.feature_measured = document.number()
            at = document.add(measured, "PointFeatureMeasurement", id=row.feature_measured)
            document.add(at, "FeatureItemId", row.feature)
            document.add(at, "Location", _triple(_measured_place(row.values)))
    if rows:
        measured = document.add(element, "MeasuredCharacteristics/CharacteristicMeasurements",
                                n=str(len(rows)))  # fmt: skip
        for row in rows:
            _measurement(document, measured, row)
    document.add(element, "InspectionStatus/InspectionStatusEnum", verdict)
    document.add(element, "ActualComponentIds", n="1")
    document.add(element[-1], "Id", component)
    sets = document.add(holder, "ActualComponentSets", n="1")
    actual = document.add(
        document.add(sets, "ActualComponentSet", n="1"), "ActualComponent", id=component
    )
    if job.get("serial_number"):
        document.add(actual, "SerialNumber", job["serial_number"])
    document.add(actual, "Status/InspectionStatusEnum", verdict)
    trace = document.add(holder, "InspectionTraceability")
    if job.get("order_id"):
        document.add(trace, "OrderNumber", job["order_id"])
    document.add(trace, "ReportNumber", job.get("id"))
    if job.get("operator_name"):
        document.add(trace, "InspectionOperator/Name", job["operator_name"])
    document.add(trace, "ReportPreparationDate", moment)
    _attributes(document, trace, job)


def _measurement(document: _Document, parent: ET.Element, row: _Row) -> None:
    element = document.add(parent, row.name + "Measurement", id=document.number())
    state = _STATES.get(str(row.values["state"]), "UNDEFINED")
    document.add(element, "Status/CharacteristicStatusEnum", state)
    document.add(element, "CharacteristicItemId", row.item)
    if row.feature_measured:
        document.add(element, "FeatureMeasurementIds", n="1")
        document.add(element[-1], "Id", row.feature_measured)
    value = number(row.values.get("value_m"))
    if math.isfinite(value):
        document.add(element, "Value", _decimal(value))


def _attributes(document: _Document, parent: ET.Element, job: dict[str, Any]) -> None:
    given = section(job, "attributes")
    if given:
        listed = document.add(parent, "Attributes", n=str(len(given)))
        for key, value in given.items():
            document.add(listed, "AttributeStr", name=str(key), value=str(value))


def _place(values: Mapping[str, Any]) -> list[Any]:
    place = values.get("place")
    return list(place) if isinstance(place, list | tuple) and len(place) == 3 else [None] * 3


def _measured_place(values: Mapping[str, Any]) -> list[float]:
    normal, value = values.get("normal") or [0.0] * 3, number(values.get("value_m"))
    return [p + value * n for p, n in zip(_place(values), normal, strict=True)]


def _triple(values: Any) -> str:
    return " ".join(_decimal(float(value)) for value in values)


def _decimal(value: float) -> str:
    """Returns a number as xs:decimal writes it: no exponent."""
    text = f"{value:.9f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _clean(text: str) -> str:
    return _UNWRITABLE.sub("\ufffd", text)
