"""Frames of items (type, length, value): what a message holds changes from one to the next, and says so itself.

    items:
      begin: 4
      id: u16
      length: u8
      formats: {mask: 0x3, types: {0: f32, 1: fp12.20, 2: fp16.32, 3: f64}}
      known:
        acceleration: {id: 0x4020, mask: 0xFFF0, fields: {acc: {type: item, names: [x, y, z], unit: m/s2}}}

Items that are not known are skipped. A known item that repeats counts once, the first time.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from drivers.frames.fields import SIZES, FieldDescription, Fields, FieldType, field_offsets
from drivers.frames.notation import ByteOrder, Name
from drivers.strict_yaml import Section


class ItemFormats(Section):
    """The type of the values as bits of the item's id tell it."""

    mask: int = Field(gt=0)
    types: dict[int, FieldType]


class ItemDescription(Section):
    """One known item: those whose id, seen through `mask`, is `id`."""

    id: int = Field(ge=0)
    mask: int | None = Field(default=None, gt=0)
    fields: Fields


@dataclass(frozen=True)
class Item:
    """One item: its id, where it and its data begin in the frame, and the size of the data."""

    id: int
    at: int
    data: int
    size: int


class ItemsDescription(Section):
    """Where the items begin and how each begins; they go on to the checksum.

    `extended_begin` is where they begin in a frame whose length is extended. The length of an item counts its `data`,
    or the whole `item` with its id and length.
    """

    begin: int = Field(ge=1)
    extended_begin: int | None = Field(default=None, ge=1)
    order: Literal["id_first", "length_first"] = "id_first"
    id: Literal["u8", "u16"] = "u8"
    length: Literal["u8", "u16"] = "u8"
    length_counts: Literal["data", "item"] = "data"
    byte_order: ByteOrder = "big"
    formats: ItemFormats | None = None
    known: dict[Name, ItemDescription] = Field(default_factory=dict)

    def _check(self) -> None:
        names: dict[str, str] = {}
        for name, item in self.known.items():
            if item.mask is not None and item.id & ~item.mask:
                raise ValueError(f"known.{name}.mask: hides a part of the id {item.id:#x}")
            for field, described in item.fields.items():
                place = f"known.{name}.fields.{field}"
                if field in names:
                    raise ValueError(f"{place}: the name is already that of a field of {names[field]}")
                if described.type in ("decimal", "line"):
                    raise ValueError(f"{place}.type: {described.type} belongs to a frame of text")
                if described.when is not None:
                    raise ValueError(f"{place}.when: in an item, give each case an id of its own")
                if described.type == "item" and self.formats is None:
                    raise ValueError(f"{place}.type: formats are missing, which tell the type from the id")
                names[field] = name

    def all_fields(self) -> dict[str, FieldDescription]:
        """Return the fields of every known item."""
        return {name: field for item in self.known.values() for name, field in item.fields.items()}

    def walk(self, frame: bytes, begin: int, end: int) -> list[Item] | None:
        """Return the items between `begin` and `end`; None where they do not fill it exactly."""
        id_size, length_size = SIZES[self.id], SIZES[self.length]
        id_at, length_at = (0, id_size) if self.order == "id_first" else (length_size, 0)
        items, at, header = [], begin, id_size + length_size
        while at < end:
            if at + header > end:
                return None
            found = int.from_bytes(frame[at + id_at : at + id_at + id_size], self.byte_order)
            told = int.from_bytes(frame[at + length_at : at + length_at + length_size], self.byte_order)
            size = told - header if self.length_counts == "item" else told
            if size < 0 or at + header + size > end:
                return None
            items.append(Item(found, at, at + header, size))
            at += header + size
        return items

    def placed(self, items: Sequence[Item]) -> Iterator[tuple[str, FieldDescription, int]]:
        """Return the known fields in `items`: name, description with its true type, offset in the frame."""
        seen: set[str] = set()
        for item in items:
            for name, known in self.known.items():
                if name in seen or (item.id if known.mask is None else item.id & known.mask) != known.id:
                    continue
                seen.add(name)
                fields = self._resolved(known.fields, item.id)
                for field, offset in field_offsets(fields, 0).items():
                    if fields[field].width and offset + fields[field].width <= item.size:
                        yield field, fields[field], item.data + offset
                break

    def _resolved(self, fields: Mapping[str, FieldDescription], found: int) -> dict[str, FieldDescription]:
        if self.formats is None:
            return dict(fields)
        mask = self.formats.mask
        number = (found & mask) >> ((mask & -mask).bit_length() - 1)
        kind = self.formats.types.get(number)
        if kind not in SIZES:
            return dict(fields)
        return {n: f.model_copy(update={"type": kind}) if f.type == "item" else f for n, f in fields.items()}
