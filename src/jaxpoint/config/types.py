"""Numbers with a range, checked when settings are read."""

from typing import Annotated, Literal

from msgspec import Meta

from jaxpoint.errors import UsageError

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=0)]
Unit = Literal["m", "cm", "mm"] | None


def check_not_above(low_key: str, low: float, high_key: str, high: float) -> None:
    """Two settings that only make sense in this order.

    Raises:
        UsageError: the first is above the second.
    """
    if low > high:
        raise UsageError(
            f"The setting '{low_key}' cannot be used: it is {low:g}, above {high_key}, which is {high:g}; lower the "
            "one or raise the other."
        )
