"""GeoJSON missions (RFC 7946): LineString and Point features in order, longitude before latitude.

Properties of a feature: speed_m_s, acceptance_m (for all its points), end_heading_deg (last feature, from
true north). Names and the styling that map editors add are let through; any other property is an error, and
so are any other geometry and any other coordinate system.
"""

from __future__ import annotations

import msgspec

from companion.core.guidance.missions.draft import Draft
from companion.core.guidance.path import Waypoint

COSMETIC = {
    "name", "title", "description", "id", "stroke", "stroke-width", "stroke-opacity", "fill", "fill-opacity",
    "marker-color", "marker-size", "marker-symbol",
}  # fmt: skip
"""Properties without a meaning for driving (simplestyle-spec 1.1 and names)."""


class _Geometry(msgspec.Struct):
    type: str
    coordinates: list = []


class _Properties(msgspec.Struct, forbid_unknown_fields=True):
    speed_m_s: float | None = None
    acceptance_m: float | None = None
    end_heading_deg: float | None = None


class _Feature(msgspec.Struct):
    type: str
    geometry: _Geometry | None = None
    properties: dict | None = None


class _Document(msgspec.Struct):
    type: str
    features: list[_Feature] = []
    crs: dict | None = None


def read_geojson(draft: Draft, text: str) -> None:
    """A FeatureCollection, or one Feature, into the draft."""
    try:
        document = msgspec.json.decode(text, type=_Document)
        single = document.type == "Feature"
        features = [msgspec.json.decode(text, type=_Feature)] if single else document.features
    except msgspec.ValidationError as error:
        draft.schema_error("", error)
        return
    except msgspec.DecodeError as error:
        draft.error("(file)", f"not valid JSON: {error}")
        return
    if document.type not in ("FeatureCollection", "Feature"):
        draft.error("type", f"expected FeatureCollection or Feature, found {document.type!r}")
    if document.crs is not None and "CRS84" not in str(document.crs):
        draft.error("crs", "only WGS84 longitude and latitude (CRS84) are supported")
    for i, feature in enumerate(features):
        place = "(feature)" if single else f"features[{i}]"
        _read_feature(draft, place, feature, is_last=i == len(features) - 1)


def _read_feature(draft: Draft, place: str, feature: _Feature, *, is_last: bool) -> None:
    given = {k: v for k, v in (feature.properties or {}).items() if k not in COSMETIC}
    try:
        properties = msgspec.convert(given, _Properties)
    except msgspec.ValidationError as error:
        draft.schema_error(f"{place}.properties", error)
        properties = _Properties()
    if properties.end_heading_deg is not None and not is_last:
        draft.error(f"{place}.properties.end_heading_deg", "is supported only at the last feature")
    draft.heading(f"{place}.properties.end_heading_deg", properties.end_heading_deg, from_north=True)
    geometry = feature.geometry
    where = f"{place}.geometry.coordinates"
    if geometry is not None and geometry.type == "Point":
        _read_point(draft, where, geometry.coordinates, properties)
    elif geometry is not None and geometry.type == "LineString":
        for k, point in enumerate(geometry.coordinates):
            _read_point(draft, f"{where}[{k}]", point, properties)
    else:
        kind = geometry.type if geometry else "nothing"
        draft.error(f"{place}.geometry", f"{kind} is not supported, only Point and LineString")


def _read_point(draft: Draft, place: str, point: object, properties: _Properties) -> None:
    """Longitude, latitude and perhaps an altitude, which is ignored."""
    if not isinstance(point, list) or len(point) not in (2, 3):
        draft.error(place, "expected [longitude, latitude] or [longitude, latitude, altitude]")
        return
    at = draft.position(place, point[1], point[0])
    if at:
        draft.waypoint(place, Waypoint(*at, properties.speed_m_s, properties.acceptance_m))
