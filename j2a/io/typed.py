"""Functions of a device that take and return values.

What flows in: functions of Python and their signatures. What flows out: the same, from payload to
payload. Rules: a payload of another size than the signature says executes nothing.
"""

from collections.abc import Callable
from typing import Any

from j2a_spec.constants import RET_FAILED

from j2a.errors import WrongArgument
from j2a.io.functions import Result, WrongResult
from j2a.types.coding import Codec, PayloadMismatchError, PythonTypes
from j2a.types.model import Signature

__all__ = ["TypedFunction"]


class TypedFunction:
    """Executes a function of Python by its signature (J2A-TYPE-005, J2A-TYPE-006).

    Args:
        function: takes the values of the parameters; returns nothing, the result or all results.
        signature: says what payloads mean.
        types: the classes of the values.
    """

    def __init__(
        self, function: Callable[..., object], signature: Signature, types: PythonTypes
    ) -> None:
        self.function = function
        self._results = Codec(signature.results, types)
        self._parameters = Codec(signature.parameters, types)
        self._is_single = [field.name for field in signature.results] == [""]

    def __call__(self, payload: bytes) -> Result:
        """Execute a request."""
        try:
            values = self._parameters.unpack(payload)
        except PayloadMismatchError:
            return RET_FAILED
        result: Any = self.function(*values)
        if self._is_single:
            result = (result,)
        elif result is None:
            result = ()
        elif not isinstance(result, tuple | list):
            raise WrongResult(f"{result!r:.60} is not all of its results")
        try:
            return self._results.pack(result)
        except WrongArgument as error:
            raise WrongResult(*error.args) from None
