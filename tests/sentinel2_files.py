"""Granule and datastrip of Sentinel-2 L1B after the published specification: none was at hand."""

from __future__ import annotations

from pathlib import Path

#: s of the first line of each band after 10:00:00 GPS time, and its number; odd detectors look in turn.
STARTS = {"B02": (1, 4.25), "B03": (2, 3.723), "B04": (3, 3.245), "B08": (7, 3.986)}
GRANULE, DATASTRIP = "S2A_OPER_MTD_L1B_GR_X_D05.xml", "S2A_OPER_MTD_L1B_DS_X_S20260101T095900.xml"
#: mm, Earth-fixed: 786 km above the equator, where the ellipsoid is 6 378 137 m wide.
POSITION = "7164137000 0 0"


def write_granule(folder: Path, **texts: tuple[str, str]) -> tuple[Path, Path]:
    """Metadata of both; `texts` replaces (old, new) in `granule` and `datastrip`."""
    granule = """<?xml version="1.0" encoding="UTF-8"?>
<n1:Level-1B_Granule_ID xmlns:n1="https://psd-14.sentinel2.eo.esa.int/PSD/S2_PDI_Level-1B_Granule_Metadata.xsd">
<n1:General_Info><GRANULE_ID>S2A_OPER_MSI_L1B_GR_X_D05_N02.09</GRANULE_ID><DETECTOR_ID>05</DETECTOR_ID>
<DATASTRIP_ID>S2A_OPER_MSI_L1B_DS_X_S20260101T095900_N02.09</DATASTRIP_ID></n1:General_Info>
<n1:Geometric_Info><Granule_Position><POSITION>2305</POSITION></Granule_Position></n1:Geometric_Info>
</n1:Level-1B_Granule_ID>
"""
    stamps = "".join(
        f'<Band_Time_Stamp bandId="{number}">'
        + '<Detector detectorId="04"><REFERENCE_LINE>1</REFERENCE_LINE>'
        + "<GPS_TIME>2026-01-01T10:00:00.000</GPS_TIME></Detector>"
        + '<Detector detectorId="05"><REFERENCE_LINE>1</REFERENCE_LINE>'
        + f"<GPS_TIME>2026-01-01T10:00:0{start:.3f}</GPS_TIME></Detector></Band_Time_Stamp>"
        for number, start in STARTS.values()
    )
    datastrip = f"""<?xml version="1.0" encoding="UTF-8"?>
<n1:Level-1B_DataStrip_ID xmlns:n1="https://psd-14.sentinel2.eo.esa.int/PSD/S2_PDI_Level-1B_Datastrip_Metadata.xsd">
<n1:Image_Data_Info><Sensor_Configuration><Time_Stamp><LINE_PERIOD unit="ms">1.5</LINE_PERIOD>{stamps}
</Time_Stamp></Sensor_Configuration></n1:Image_Data_Info>
<n1:Satellite_Ancillary_Data_Info><Ephemeris><GPS_Points_List>
<GPS_Point><POSITION_VALUES unit="mm">{POSITION}</POSITION_VALUES>
<GPS_TIME>2026-01-01T10:00:07</GPS_TIME></GPS_Point>
</GPS_Points_List></Ephemeris></n1:Satellite_Ancillary_Data_Info>
</n1:Level-1B_DataStrip_ID>
"""
    paths = folder / GRANULE, folder / DATASTRIP
    for path, kind, text in zip(paths, ("granule", "datastrip"), (granule, datastrip), strict=True):
        old, new = texts.get(kind, ("", ""))
        assert old in text
        path.write_text(text.replace(old, new) if old else text)
    return paths
