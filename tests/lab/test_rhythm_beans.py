"""The figures on beans' cycles in the docs: reading the table, the statistics, and the real table where it is."""

from __future__ import annotations

import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from real_photographs import DATA

ROOT = Path(__file__).parents[2]
TABLE = DATA / "bean-mechanics" / "motor_meta_and_cycle_periods.xlsx"
PAGE = ROOT / "docs" / "results" / "rhythms-of-real-plants.md"


@pytest.fixture
def beans(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "generate"))
    import bean_periods

    return bean_periods


def write_xlsx(path: Path, name: str) -> None:
    """A workbook with one sheet: a heading, a plant with two periods, and a row without any."""
    main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    links = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    package = "http://schemas.openxmlformats.org/package/2006/relationships"
    rows = (
        '<row><c r="A1" t="s"><v>0</v></c></row>'
        '<row><c r="A2" t="s"><v>1</v></c><c r="H2"><v>81</v></c><c r="I2"><v>80</v></c><c r="J2"><v>82</v></c></row>'
        '<row><c r="A3" t="s"><v>1</v></c></row>'
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns="{main}" xmlns:r="{links}"><sheets><sheet name="{name}" r:id="r7"/></sheets></workbook>',
        )
        archive.writestr(
            "xl/_rels/workbook.xml.rels",
            f'<Relationships xmlns="{package}"><Relationship Id="r7" Target="worksheets/s.xml"/></Relationships>',
        )
        archive.writestr("xl/sharedStrings.xml", f'<sst xmlns="{main}"><si><t>exp</t></si><si><t>04</t></si></sst>')
        archive.writestr("xl/worksheets/s.xml", f'<worksheet xmlns="{main}"><sheetData>{rows}</sheetData></worksheet>')


def test_the_table_is_read_without_a_spreadsheet(tmp_path: Path, beans: ModuleType) -> None:
    write_xlsx(tmp_path / "t.xlsx", beans.SHEET)
    (record,) = beans.records(tmp_path / "t.xlsx")
    assert record.plant == "04"
    assert record.minutes.tolist() == [80.0, 82.0]


def test_spreads_within_and_between_plants_and_the_trend_are_those_that_were_drawn(beans: ModuleType) -> None:
    rng = np.random.default_rng(1)
    plants = [beans.Record(str(k), rng.normal(80, 5) + 0.5 * np.arange(12) + rng.normal(0, 3, 12)) for k in range(80)]
    told = beans.figures(plants)
    assert told["mean"] == pytest.approx(80.0 + 0.5 * 5.5, abs=1.5)
    assert told["between"] == pytest.approx(5.0, rel=0.25)
    assert told["within_without_trend"] == pytest.approx(3.0, rel=0.1)
    assert told["trend_per_cycle"] == pytest.approx(0.5, abs=0.15)
    assert told["trend_chance"] < 0.001


def test_no_trend_is_told_where_none_was_drawn(beans: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beans, "SHUFFLES", 99)
    rng = np.random.default_rng(2)
    chances = [
        beans.figures([beans.Record(str(k), rng.normal(80, 4, 12)) for k in range(6)])["trend_chance"]
        for _ in range(30)
    ]
    assert np.count_nonzero(np.array(chances) <= 0.05) <= 5
    assert np.median(chances) > 0.2


@pytest.mark.skipif(not TABLE.exists(), reason=f"{TABLE.name} is not on this machine")
def test_the_page_has_the_figures_of_the_table(beans: ModuleType) -> None:
    told = beans.figures(beans.records(TABLE))
    assert (told["plants"], told["records"], told["cycles"]) == (14, 15, 124)
    page = PAGE.read_text()
    for name, digits in (("mean", 1), ("within", 1), ("between", 1), ("trend_per_cycle", 2), ("trend_error", 2)):
        assert f"{told[name]:.{digits}f}" in page, name
