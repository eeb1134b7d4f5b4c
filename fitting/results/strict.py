"""What the parts of a result are made of: they refuse unknown fields, and names that no file has."""

from collections.abc import Sized
from pathlib import PurePath
from typing import Annotated, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, FailFast


class _First(FailFast):
    """Only the first wrong item is reported: a million of them would take a kilobyte each."""

    def __hash__(self) -> int:
        """Unions need one."""
        return hash(self.fail_fast)


Item = TypeVar("Item")
Many = Annotated[list[Item], _First()]


class Strict(BaseModel):
    """A part of a result: it refuses what it does not know, and numbers that are none."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


def readable(text: object) -> object:
    """File names are bytes: of one that is no UTF-8, the bytes that are none become question marks."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace") if isinstance(text, str) else text


def _file_name(name: str) -> str:
    """Only what stays in its folder when a path is made of it."""
    if name in ("", ".", "..") or PurePath(name).name != name or "\0" in name:
        raise ValueError(f"{name!r} is not the name of a file without its folder")
    return name


Text = Annotated[str, BeforeValidator(readable)]
FileName = Annotated[Text, AfterValidator(_file_name)]


def same_length(first: str, size: int, **lists: Sized) -> None:
    """Refuse a list that is longer or shorter than the ``first`` one."""
    for name, each in lists.items():
        if len(each) != size:
            raise ValueError(f"{name} has {len(each)} entries, {first} {size}")
