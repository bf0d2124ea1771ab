"""The rows of a table, such as the subsets of a result, as plain dictionaries or as a pandas DataFrame."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from pandas import DataFrame

Row = TypeVar("Row", bound=Mapping[str, object])


class Rows(list[Row], Generic[Row]):
    """A list of rows, each a dictionary with the same fields."""

    def to_frame(self) -> "DataFrame":
        """A DataFrame with a line for each row. Needs pandas: `pip install scene-attack[pandas]`."""
        try:
            import pandas
        except ImportError as error:
            said = "a DataFrame needs pandas: pip install 'scene-attack[pandas]'; the rows themselves are dictionaries"
            raise ImportError(said) from error
        return pandas.DataFrame.from_records(list(self))
