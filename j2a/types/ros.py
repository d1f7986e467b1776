"""ROS messages of transducers, with the package around them.

What flows in: descriptors. What flows out: the texts of files, by their path in the package.
Rules: a message has the times and the values of all channels (thesis, listing 8.2), or, of a sensor
with a queue, of the values that come, with their channels; a value is raw.
ROS 1 keeps the names of transducers; ROS 2 wants them in CamelCase, and those of fields in lower
case.
"""

import re
from collections.abc import Callable, Container, Iterator
from typing import Final

from j2a.types.model import INTEGERS, Enumeration, Field, Structure, Type
from j2a.types.naming import free_name, is_reserved
from j2a.types.transducers import Descriptors, Transducer

__all__ = [
    "PACKAGE",
    "camel_case",
    "ros1_messages",
    "ros1_package",
    "ros2_definition",
    "ros2_messages",
    "ros2_package",
]

PACKAGE: Final = "j2a_msgs"
"""The name of the package."""

_NUMBERS: Final = {
    **{name: f"{'u' if name[0] == 'u' else ''}int{bits}" for name, bits in INTEGERS.items()},
    "bool": "bool",
    "f32": "float32",
    "f64": "float64",
}

_BUILTIN: Final = frozenset(
    {*_NUMBERS.values(), "string", "wstring", "byte", "char", "time", "duration", "Header"}
)
"""Types of ROS 1, for which it would take a structure of the same name."""


class _Dialect:
    """What differs between ROS 1 and ROS 2.

    Args:
        time: the type of a time.
        message: makes the name of a message of one of J2A.
        field: makes the name of a field of one of J2A.
    """

    def __init__(
        self, time: str, message: Callable[[str], str], field: Callable[[str], str]
    ) -> None:
        self._time = time
        self._message = message
        self._field = field

    def messages(self, descriptors: Descriptors) -> dict[str, str]:
        """Return the text of each message by its name."""
        names = _Names(self._message)
        for transducer in descriptors.transducers:
            names.give(transducer)
        for definition in descriptors.types:
            if isinstance(definition, Structure):
                names.give(definition, _BUILTIN)
        found = {}
        for transducer in descriptors.transducers:
            lines = [*_constants([transducer.type], set()), f"{self._time}[] times"]
            lines.append(f"{self._element(transducer.type, names)}[] values")
            if transducer.queue:
                lines += ["uint8[] channels", "uint16 lost"]
            found[names[transducer]] = "".join(f"{line}\n" for line in lines)
        for definition in descriptors.types:
            if isinstance(definition, Structure):
                found[names[definition]] = "".join(
                    f"{line}\n" for line in self._structure(definition, names)
                )
        return found

    def _structure(self, definition: Structure, names: "_Names") -> Iterator[str]:
        fields = _Names(self._field)
        yield from _constants([field.type for field in definition.fields], fields.taken)
        for field in definition.fields:
            count = "" if field.type.count is None else f"[{field.type.count}]"
            yield f"{self._element(field.type, names)}{count} {fields.give(field)}"

    def _element(self, kind: Type, names: "_Names") -> str:
        element = kind.element
        if isinstance(element, Structure):
            return names[element]
        return _NUMBERS[element.integer if isinstance(element, Enumeration) else element]


class _Names:
    """Names that differ from each other, in more than case: messages are files.

    Attributes:
        taken: in lower case.
    """

    def __init__(self, make: Callable[[str], str]) -> None:
        self._make = make
        self._of: dict[tuple[str, str], str] = {}
        self.taken: set[str] = set()

    def give(self, one: Transducer | Structure | Field, reserved: Container[str] = ()) -> str:
        """Return a name that no other one has."""
        name = self._make(one.name)
        if name in reserved:
            name = self._make(f"x_{name}")
        name = _free(name, self.taken)
        self._of[type(one).__name__, one.name] = name
        return name

    def __getitem__(self, one: Transducer | Structure) -> str:
        return self._of[type(one).__name__, one.name]


def _free(name: str, taken: set[str]) -> str:
    """Return a name that differs from those in `taken` in more than case; then it is taken, too."""
    free = free_name(name.lower(), taken)
    taken.add(free)
    return name + free[len(name) :]


def _constants(types: list[Type], taken: set[str]) -> Iterator[str]:
    """Yield a constant for each value of the enumerations."""
    seen = {one.element.name: one.element for one in types if isinstance(one.element, Enumeration)}
    for enumeration in seen.values():
        for name, number in enumeration.values:
            constant = re.sub(r"_+", "_", f"{enumeration.name}_{name}").strip("_").upper()
            constant = _free(constant if constant[:1].isalpha() else f"X{constant}", taken)
            yield f"{_NUMBERS[enumeration.integer]} {constant}={number}"


def _plain(name: str) -> str:
    """Return a name that begins with a letter, and that C++ and Python do not reserve."""
    made = name if name[0].isalpha() else f"x{name}"
    made = re.sub(r"__+", "_", made).rstrip("_")  # which not all tools of ROS take
    return f"x_{made}" if is_reserved(made) else made


def camel_case(name: str) -> str:
    """Return a name as ROS 2 wants it of a message: `dist_ir` becomes `DistIr`."""
    words = [word for word in name.split("_") if word]
    made = "".join(word[0].upper() + word[1:] for word in words)
    return made if made[:1].isalpha() and not is_reserved(made) else f"X{made}"


def _lower_case(name: str) -> str:
    """Return a name as ROS 2 wants it of a field: `rateX` becomes `rate_x`."""
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
    return _plain(re.sub(r"_+", "_", apart).strip("_") or "x")


def _used(kind: Type, names: set[str]) -> set[str]:
    """Add the names of the structures that values of a type consist of, each once; return them."""
    if isinstance(kind.element, Structure) and kind.element.name not in names:
        names.add(kind.element.name)
        for field in kind.element.fields:
            _used(field.type, names)
    return names


def ros1_messages(descriptors: Descriptors) -> dict[str, str]:
    """Return the messages of ROS 1 by their name, such as `quad`; those of sensors come first."""
    return _Dialect("time", _plain, _plain).messages(descriptors)


def ros2_messages(descriptors: Descriptors) -> dict[str, str]:
    """Return the messages of ROS 2 by their name, such as `Quad`."""
    return _Dialect("builtin_interfaces/Time", camel_case, _lower_case).messages(descriptors)


def ros2_definition(descriptors: Descriptors, name: str) -> tuple[str, str]:
    """Return the type of the messages of a transducer, and its definition with all that it uses.

    Args:
        descriptors: of the board.
        name: of the transducer.
    """
    messages = ros2_messages(descriptors)
    own = list(messages)[[one.name for one in descriptors.transducers].index(name)]
    others = list(messages)[len(descriptors.transducers) :]
    structures = [one for one in descriptors.types if isinstance(one, Structure)]
    # Not all of the board: each recorded channel has a definition of its own.
    used = _used(descriptors[name].type, set())
    parts = [messages[own], f"MSG: builtin_interfaces/Time\n{_TIME}"]
    parts += [
        f"MSG: {PACKAGE}/{other}\n{messages[other]}"
        for other, one in zip(others, structures, strict=True)
        if one.name in used
    ]
    return f"{PACKAGE}/msg/{own}", f"{'=' * 80}\n".join(parts)


def ros1_package(descriptors: Descriptors) -> dict[str, str]:
    """Return the files of a package of ROS 1 by their path, such as `msg/quad.msg`."""
    return {
        **{f"msg/{name}.msg": text for name, text in ros1_messages(descriptors).items()},
        "package.xml": _XML.format(
            format=2,
            package=PACKAGE,
            rest="  <buildtool_depend>catkin</buildtool_depend>\n"
            "  <build_depend>message_generation</build_depend>\n"
            "  <exec_depend>message_runtime</exec_depend>\n",
        ),
        "CMakeLists.txt": _CMAKE1.replace("PACKAGE", PACKAGE),
    }


def ros2_package(descriptors: Descriptors) -> dict[str, str]:
    """Return the files of a package of ROS 2 by their path, such as `msg/Quad.msg`."""
    return {
        **{f"msg/{name}.msg": text for name, text in ros2_messages(descriptors).items()},
        "package.xml": _XML.format(
            format=3,
            package=PACKAGE,
            rest="  <buildtool_depend>ament_cmake</buildtool_depend>\n"
            "  <buildtool_depend>rosidl_default_generators</buildtool_depend>\n"
            "  <depend>builtin_interfaces</depend>\n"
            "  <exec_depend>rosidl_default_runtime</exec_depend>\n"
            "  <member_of_group>rosidl_interface_packages</member_of_group>\n"
            "  <export><build_type>ament_cmake</build_type></export>\n",
        ),
        "CMakeLists.txt": _CMAKE2.replace("PACKAGE", PACKAGE),
    }


_TIME: Final = "int32 sec\nuint32 nanosec\n"
_XML: Final = """\
<?xml version="1.0"?>
<package format="{format}">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Messages of the transducers of boards, written by j2a transds.</description>
  <maintainer email="nobody@example.com">nobody</maintainer>
  <license>none</license>
{rest}</package>
"""
_CMAKE1: Final = """\
cmake_minimum_required(VERSION 3.0.2)
project(PACKAGE)
find_package(catkin REQUIRED COMPONENTS message_generation)
file(GLOB messages RELATIVE ${CMAKE_CURRENT_SOURCE_DIR}/msg msg/*.msg)
add_message_files(FILES ${messages})
file(GLOB services RELATIVE ${CMAKE_CURRENT_SOURCE_DIR}/srv srv/*.srv)
if(services)
  add_service_files(FILES ${services})
endif()
generate_messages()
catkin_package(CATKIN_DEPENDS message_runtime)
"""
_CMAKE2: Final = """\
cmake_minimum_required(VERSION 3.8)
project(PACKAGE)
find_package(ament_cmake REQUIRED)
find_package(builtin_interfaces REQUIRED)
find_package(rosidl_default_generators REQUIRED)
file(GLOB messages RELATIVE ${CMAKE_CURRENT_SOURCE_DIR} msg/*.msg)
rosidl_generate_interfaces(${PROJECT_NAME} ${messages} DEPENDENCIES builtin_interfaces)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
