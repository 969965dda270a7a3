"""docs/formats.md matches the descriptions of the readers."""

import pointray as pr
from bench.maintenance import formats_table


def test_the_document_is_up_to_date():
    assert formats_table.TARGET.read_text() == formats_table.formats_page(), "run bench.maintenance.formats_table"


def test_every_format_is_in_both_tables():
    page = formats_table.formats_page()
    for known in pr.formats():
        assert page.count(f"\n| {known.name} |") == 2 + known.writes
        assert set(known.keeps) <= {*formats_table.COLUMNS, "note"}, known.name
