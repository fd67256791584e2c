"""The filters that an airframe file may name.

A new one is a file next to this one and a line here. A package of somebody else's adds its own without a change here,
as an entry point of the group `GROUP`: the name is what airframe files say, the value a class that is a `Section` with
the key ``filter`` and ``make``, as those of this folder are.
"""

from typing import Annotated, Any, get_args

from pydantic import Field, GetJsonSchemaHandler, ValidationInfo, ValidatorFunctionWrapHandler, WrapValidator
from pydantic_core import CoreSchema

from msp_range.filters.changepoint import ChangepointParameters
from msp_range.filters.kalman import KalmanParameters
from msp_range.filters.median import MedianParameters
from msp_range.filters.moving_average import MovingAverageParameters
from msp_range.plugins import installed, load_entry
from msp_range.yaml_file import Section, check

GROUP = "msp_range.filters"
"""Entry points of installed packages that are filters."""

BuiltIn = MovingAverageParameters | MedianParameters | KalmanParameters | ChangepointParameters
BUILT_IN = [get_args(parameters.model_fields["filter"].annotation)[0] for parameters in get_args(BuiltIn)]
"""Their names in airframe files."""


def _own(value: Any, built_in: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
    """The parameters of a filter; those of another package's are checked by its own class."""
    name = value.get("filter") if isinstance(value, dict) else None
    if isinstance(name, str) and name not in BUILT_IN:
        others = installed(GROUP)
        if name in others:
            section = load_entry(others[name], "filter", Section)
            return check(f"filter {name!r}", section, value, info.context)
        if others:
            raise ValueError(f"filter: found {name!r}; expected one of {', '.join([*BUILT_IN, *others])}")
    return built_in(value)


class _InSchema:
    """Lets the JSON Schema of airframe files accept the filters of other packages."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        described = handler(schema)
        others = [load_entry(entry, "filter", Section) for entry in installed(GROUP).values()]
        described["oneOf"] += [other.model_json_schema() for other in others]
        return described


FilterParameters = Annotated[BuiltIn, Field(discriminator="filter"), WrapValidator(_own), _InSchema()]
