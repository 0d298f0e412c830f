"""What people did, rather than a device: bad input and usage. The class stands with the ground of the drivers."""

from __future__ import annotations

from drivers.errors import InputError as InputError
