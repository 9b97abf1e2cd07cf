"""A message about dates that are text names the order of day and month that pandas would get wrong."""

import pytest

from robust_filterpy.identification import ARX, identify

pd = pytest.importorskip("pandas")


@pytest.mark.parametrize(("form", "said"), [
    ("%d.%m.%Y %H:%M", r"pd\.to_datetime\(df\.index, dayfirst=True, utc=True\)$"),
    ("%d/%m/%Y %H:%M", r"pd\.to_datetime\(df\.index, utc=True\); with dayfirst=True where the day stands first$"),
    ("%Y-%m-%d %H:%M", r"pd\.to_datetime\(df\.index, utc=True\)$"),
])  # fmt: skip
def test_text_that_reads_as_a_date(form, said):
    times = pd.date_range("2026-01-10", periods=60, freq="6h").strftime(form)
    df = pd.DataFrame({"y": range(60), "u": range(60)}, index=times, dtype=float)
    with pytest.raises(ValueError, match=said):
        identify(df["y"], df["u"], ARX(1, 1))
