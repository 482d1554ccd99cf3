"""Settings that a job file can hold: a model of one field each, which states everything about it.

Job files, `--set`, messages, help, `arfx stages` and the job's keys follow from the fields."""

from typing import Annotated, Any

import pydantic.dataclasses
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

Fraction = Annotated[float, Field(ge=0, le=1)]


class Settings(BaseModel):
    """Typed and frozen; pydantic's ValidationError says what is wrong with each field."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        allow_inf_nan=False,
        defer_build=True,
    )

    @field_validator("*", mode="before")
    @classmethod
    def _no_flag_for_a_number(cls, value: Any, field: ValidationInfo) -> Any:
        kind = cls.model_fields[str(field.field_name)].annotation
        if isinstance(value, bool) and kind in (int, float):
            raise ValueError(f"must be a number, is {str(value).lower()}")
        return value


def setting(
    default: Any, text: str, option: str = "", help: str = "", **limits: Any
) -> Any:
    """A setting and what it does. limits : ge, gt, le, lt
    option : its option as in help, "-o --output PATH"; FILE is no folder, PATH may be one;
    CLIP alone is an argument. What a bool's option gives is not the default
    help : where the option says something else than `text`
    """
    return Field(
        default=default,
        description=text,
        json_schema_extra={"option": option, "help": help or text},
        **limits,
    )


def listed(value: Any) -> Any:
    """A list as it is written after an option."""
    return (
        [part.strip() for part in value.split(",")]
        if isinstance(value, str)
        else value
    )


def converted(settings: Settings, kind: type[Settings], **changes: Any) -> Any:
    """Settings of another formula: those that both have, and changes."""
    both = settings.__class__.model_fields.keys() & kind.model_fields.keys() - {
        "formula"
    }
    return kind(**{name: getattr(settings, name) for name in both} | changes)


def from_dataclass(kind: type) -> Any:
    """Settings that a plug-in states as a frozen dataclass: read in the same way, without texts."""
    config = ConfigDict(
        extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False
    )
    return pydantic.dataclasses.dataclass(frozen=True, config=config)(kind)
