"""Interfaces and values that hypothesis makes up, with the spread of what can be described."""

from hypothesis import strategies as st

from j2a.types.model import (
    INTEGERS,
    OPEN,
    SCALARS,
    Described,
    Enumeration,
    Field,
    Interface,
    SifShape,
    Signature,
    Structure,
    Type,
    integer_range,
)

NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,9}", fullmatch=True)
LABELS = st.from_regex(r"[!-'\)-~]{1,12}", fullmatch=True)
UNITS = st.sampled_from(("", "", "mV", "Cel", "deg", "m/s2", "[in_i]", "%", "10*-3"))
DOCS = st.sampled_from(("", "", "Adds two numbers.", "Grüße # !slow(3)", "("))


def is_type_name(name):
    return name not in SCALARS and name not in OPEN


TYPE_NAMES = NAMES.filter(is_type_name)


@st.composite
def enumerations(draw, some_names=NAMES):
    integer = draw(st.sampled_from(sorted(INTEGERS)))
    allowed = integer_range(integer)
    numbers = st.integers(allowed[0], allowed[-1])
    names = draw(st.lists(some_names, min_size=1, max_size=5, unique=True))
    values = draw(st.lists(numbers, min_size=len(names), max_size=len(names), unique=True))
    return Enumeration(
        draw(some_names.filter(is_type_name)), integer, tuple(zip(names, values, strict=True))
    )


def closed_types(types, budget):
    """Types of a known size of at most `budget` bytes."""
    elements = [one for one in (*SCALARS, *types) if Type(one).size <= budget]

    @st.composite
    def make(draw):
        element = draw(st.sampled_from(elements))
        most = budget // Type(element).size
        count = draw(st.one_of(st.none(), st.integers(1, min(most, 6))))
        return Type(element, count, draw(UNITS))

    return make()


@st.composite
def open_types(draw, types):
    if draw(st.booleans()):
        count = draw(st.one_of(st.none(), st.integers(1, 65535)))
        return Type(draw(st.sampled_from(OPEN)), count, draw(UNITS))
    return Type(draw(st.sampled_from((*SCALARS, *types))), 0, draw(UNITS))


@st.composite
def field_lists(draw, types, *, least=0, most=4, budget=255, may_be_open=True, names=NAMES):
    names = draw(st.lists(names, min_size=least, max_size=most, unique=True))
    fields = []
    for number, name in enumerate(names, 1):
        if may_be_open and number == len(names) and draw(st.booleans()):
            kind = draw(open_types(types))
        elif budget:
            kind = draw(closed_types(types, budget))
        else:
            break
        budget -= kind.size
        fields.append(Field(name, kind))
    return tuple(fields)


@st.composite
def signatures(draw, types=()):
    results = draw(field_lists(types))
    if len(results) == 1 and draw(st.booleans()):
        results = (Field("", results[0].type),)
    return Signature(draw(field_lists(types)), results)


@st.composite
def functions(draw, types=()):
    name, doc = draw(LABELS), draw(DOCS)
    how = draw(st.sampled_from(("raw", "call", "call", "many", "content")))
    return Described(
        name,
        signature=draw(signatures(types)) if how == "call" else None,
        is_many=how in ("many", "content"),
        content=draw(st.one_of(closed_types(types, 249), open_types(types)))
        if how == "content"
        else None,
        idempotent=draw(st.booleans()),
        slow_ms=draw(st.one_of(st.none(), st.integers(1, 65535))),
        doc=doc,
    )


@st.composite
def interfaces(draw):
    types = draw(st.lists(enumerations(), max_size=2, unique_by=lambda one: one.name))
    for name in draw(st.lists(TYPE_NAMES, max_size=3, unique=True)):
        if name not in {one.name for one in types}:
            fields = draw(field_lists(types, least=1, budget=40, may_be_open=False))
            types.append(Structure(name, fields))
    sifs = [
        SifShape(name, opcode, draw(field_lists(types)), draw(DOCS))
        for name, opcode in draw(
            st.lists(
                st.tuples(NAMES, st.integers(0, 255)),
                max_size=2,
                unique_by=(lambda one: one[0], lambda one: one[1]),
            )
        )
    ]
    lines = draw(st.lists(functions(types), max_size=6, unique_by=lambda one: one.name))
    return Interface(tuple(types), tuple(sifs), tuple(lines))


def values_of(kind):
    """Values of a type, as coding takes and returns them (without the classes)."""
    if kind.element == "text":
        most = 60 if kind.count is None else min(kind.count, 60)
        return st.text(st.characters(codec="utf-8"), max_size=most // 4)
    if kind.element == "bytes":
        return st.binary(max_size=60 if kind.count is None else min(kind.count, 60))
    one = _value(kind.element)
    if kind.count is None:
        return one
    size = Type(kind.element).size
    least, most = (kind.count, kind.count) if kind.count else (0, min(6, 60 // size))
    return st.lists(one, min_size=least, max_size=most).map(tuple)


def _value(element):
    if isinstance(element, Enumeration):
        return st.sampled_from([number for _, number in element.values])
    if isinstance(element, Structure):
        return st.tuples(*(values_of(field.type) for field in element.fields))
    if element == "bool":
        return st.booleans()
    if element in INTEGERS:
        allowed = integer_range(element)
        return st.integers(allowed[0], allowed[-1])
    return st.floats(width=int(element[1:]), allow_nan=False)


@st.composite
def filled(draw, fields):
    """One value for each field, short enough for a payload where the last one is open."""
    values = tuple(draw(values_of(field.type)) for field in fields)
    if fields and fields[-1].type.is_open:
        fixed = sum(field.type.size for field in fields)
        if fixed > 255 - 60:
            empty = {"text": "", "bytes": b""}.get(str(fields[-1].type.element), ())
            values = (*values[:-1], empty)
    return values
