"""The order that the PTB's schema DCC 3.1.2 prescribes, of the elements that hilcell writes.

No package of the index ships the schema itself: these are its rules, in our own words. A rule is
a regular expression over the names of an element's children, each followed by a blank.
"""

import re
from xml.etree.ElementTree import Element

DCC, SI = "{https://ptb.de/dcc}", "{https://ptb.de/si}"
TEXT = "(content )+"
CONTACT = "name eMail (phone )?(fax )?location (descriptionData )?"
LIST_END = "(usedMethods )?(usedSoftware )?(measuringEquipments )?(influenceConditions )?"
LIST_END += "(measurementMetaData )?"
ORDER = {
    "digitalCalibrationCertificate": "administrativeData measurementResults ",
    "administrativeData": "dccSoftware coreData items calibrationLaboratory respPersons customer "
    "statements ",
    "dccSoftware": "(software )+", "usedSoftware": "(software )+",
    "software": "name release (type )?(description )?",
    "coreData": "countryCodeISO3166_1 (usedLangCodeISO639_1 )+(mandatoryLangCodeISO639_1 )+"
    "uniqueIdentifier (identifications )?(receiptDate )?beginPerformanceDate endPerformanceDate "
    "performanceLocation (previousReport )?",
    "identifications": "(identification )+", "identification": "issuer value (name )?",
    "items": "(name )?(equipmentClass )?(description )?(owner )?(identifications )?(item )+",
    "item": "name (equipmentClass )?(description )?(installedSoftwares )?manufacturer (model )?"
    "identifications ",
    "manufacturer": "name (eMail )?", "person": "name (eMail )?",
    "calibrationLaboratory": "(calibrationLaboratoryCode )?contact ",
    "contact": CONTACT, "customer": CONTACT, "location": "((countryCode|further) )+",
    "respPersons": "(respPerson )+",
    "respPerson": "person (description )?(role )?(mainSigner )?",
    "statements": "(statement )+", "measurementMetaData": "(metaData )+",
    **dict.fromkeys(
        ("statement", "metaData"),
        "(countryCodeISO3166_1 )*(convention )?(traceable )?(norm )*(reference )*(declaration )?"
        "(valid )?(date )?(period )?(respAuthority )?(conformity )?(data )?(location )?",
    ),
    **dict.fromkeys(("name", "description", "declaration", "further", "text"), TEXT),
    "measurementResults": "(measurementResult )+",
    "measurementResult": "name (description )?(usedMethods )?(usedSoftware )?"
    "(measuringEquipments )?(influenceConditions )?results (measurementMetaData )?",
    "usedMethods": "(usedMethod )+", "usedMethod": "name (description )?(norm )*(reference )*",
    "measuringEquipments": "(name )?(measuringEquipment )+",
    "measuringEquipment": "name (equipmentClass )?(description )?(certificate )?(manufacturer )?"
    "(model )?(identifications )?",
    "influenceConditions": "(influenceCondition )+",
    "influenceCondition": "name (description )?(status )?(certificate )?data ",
    "results": "(result )+", "result": "name (description )?data ",
    "data": "((text|quantity|list) )+",
    "list": "(name )?(description )?((quantity )+|(list )+)" + LIST_END,
    "quantity": "(name )?(description )?real " + LIST_END,
    "real": "(label )?value unit (dateTime )?(expandedUnc )?",
    "expandedUnc": "uncertainty coverageFactor coverageProbability (distribution )?",
}  # fmt: skip
FIGURE = r"[-+]?\d+(\.\d+)?"
WORDS = {
    "countryCodeISO3166_1": "[A-Z]{2}", "countryCode": "[A-Z]{2}",
    "usedLangCodeISO639_1": "[a-z]{2}", "mandatoryLangCodeISO639_1": "[a-z]{2}",
    "beginPerformanceDate": r"\d{4}-\d\d-\d\d", "endPerformanceDate": r"\d{4}-\d\d-\d\d",
    "performanceLocation": "laboratory|customer|laboratoryBranch|customerBranch|other",
    "issuer": "manufacturer|calibrationLaboratory|customer|owner|other",
    "status": "beforeAdjustment|afterAdjustment", "traceable": "true|false",
    "valid": "true|false", "mainSigner": "true|false", "conformity": "pass|fail|noPass",
    "value": ".+", "unit": r"(\\[a-z]+)+", "uncertainty": FIGURE, "coverageFactor": FIGURE,
    "coverageProbability": r"0\.\d+|1", "distribution": "normal",
}  # fmt: skip


def faults(root: Element) -> list[str]:
    """Return every element that breaks a rule."""
    found = []
    for element in root.iter():
        name = local(element)
        children = "".join(f"{local(child)} " for child in element)
        if not re.fullmatch(ORDER.get(name, ""), children):
            found.append(f"{name}: {children}")
        if not len(element) and not re.fullmatch(WORDS.get(name, ".+"), element.text or ""):
            found.append(f"{name}: {element.text!r}")
        in_si = name in ("real", "expandedUnc", "unit", "uncertainty", "distribution") or (
            name.startswith("coverage")
        )
        if name != "value" and in_si != element.tag.startswith(SI):
            found.append(f"{element.tag}: wrong namespace")
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    return found + [f"id {each} twice" for each in ids if ids.count(each) > 1]


def local(element: Element) -> str:
    """Return a name without its namespace."""
    return element.tag.rpartition("}")[2]
