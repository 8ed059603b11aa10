"""Base of all configuration tables: no unknown keys, strict types, immutable."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """Base of the configuration's tables."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
