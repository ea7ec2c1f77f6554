"""The dashboard for Grafana: each of its questions is answered by a year of three cells."""

from __future__ import annotations

import json
import re
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import psycopg
import pytest
from psycopg.rows import dict_row

from hilcell.plant.database import ENGINEER, Database
from hilcell.plant.shipper import ship
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.server import BLANK, Server
from tests.hilcell.plant.year import COLLISION, Model, year

DASHBOARD = json.loads(
    (Path(__file__).parents[3] / "docs/examples/grafana-plant.json").read_text("utf-8")
)
PANELS = DASHBOARD["panels"]
MONTHS = 6
Rows = dict[str, list[dict[str, Any]]]


def as_grafana_sends(sql: str, cells: str) -> str:
    """Return a question with the variables filled in."""
    since = NOW - timedelta(days=400)
    sql = re.sub(
        r"\$__timeFilter\(([\w.]+)\)", rf"\1 BETWEEN '{since.isoformat()}' AND '{NOW}'", sql
    )
    return sql.replace("${cell:sqlstring}", cells)


def answered(server: Server, model: Model, runs: Path) -> Rows:
    """Return what each panel is answered, asked by an engineer."""
    year(model, runs, NOW - timedelta(days=1), MONTHS)
    url = server.make(like=BLANK)
    with closing(Database(url)) as database:
        ship(runs, database)
    with psycopg.connect(url, autocommit=True, row_factory=dict_row) as connection:
        (variable,) = DASHBOARD["templating"]["list"]
        cells = connection.execute(variable["query"]).fetchall()
        all_of_them = ",".join(f"'{each['cell']}'" for each in cells)
        connection.execute(f"SET ROLE {ENGINEER}".encode())
        return {
            panel["title"]: connection.execute(
                as_grafana_sends(target["rawSql"], all_of_them).encode()
            ).fetchall()
            for panel in PANELS
            for target in panel["targets"]
        }


@pytest.mark.wall
def test_every_panel_has_its_answer_of_the_year(
    postgresql: Server, model: Model, tmp_path: Path
) -> None:
    rows = answered(postgresql, model, tmp_path)
    for panel in PANELS:
        found = rows[panel["title"]]
        assert found
        assert "$" not in as_grafana_sends(panel["targets"][0]["rawSql"], "'x'")
        if panel["type"] == "timeseries":
            assert list(found[0]) == ["time", "metric", "value"]
            assert [each["time"] for each in found] == sorted(each["time"] for each in found)
            assert all(isinstance(each["value"], float) for each in found)
    by_title = {title.partition(":")[0]: found for title, found in rows.items()}
    assert [(each["cell"], each["calibration"]) for each in by_title["Calibrations"]] == [
        (cell, f"{cell}-05") for cell in ("middle", "north", "south")
    ]
    ((code, times),) = {(each["code"], each["times"]) for each in rows["Alarms by kind"]}
    assert (code, times) == (COLLISION["code"], 1)
    worn = [each["value"] for each in by_title["Stations"] if each["metric"] == "south S300"]
    assert worn == sorted(worn)
    assert len(worn) == MONTHS
    south = [each["value"] for each in by_title["Trackers"] if each["metric"] == "T-2"]
    assert min(south) > 100.0
    assert sum(each["runs"] for each in rows["Runs of a month by their end"]) == 3 * MONTHS + 1


def test_panels_do_not_overlap() -> None:
    taken = [
        (x, y)
        for panel in PANELS
        for place in [panel["gridPos"]]
        for x in range(place["x"], place["x"] + place["w"])
        for y in range(place["y"], place["y"] + place["h"])
    ]
    assert len(taken) == len(set(taken))
    assert max(x for x, _ in taken) < 24
