"""What every table of the configuration has in common: no unknown key, no value of another type, no change afterwards."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """Base of the configuration's tables."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
