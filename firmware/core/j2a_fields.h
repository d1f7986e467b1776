/* Takes the typed entries of functions.def apart (see j2a_functions.h). In: the items of an entry, such as
 * (i32, a), (u16, voltage, mV), idempotent, "Adds." Out: one macro applied to each of them.
 * Rules: C99 with its preprocessor, no extension. A macro is not replaced within itself, so there are several
 * that paste, one for each level. */
#ifndef J2A_FIELDS_H
#define J2A_FIELDS_H

#define J2A_PASTE1_(left, right) left##right
#define J2A_PASTE1(left, right) J2A_PASTE1_(left, right)
#define J2A_PASTE2_(left, right) left##right
#define J2A_PASTE2(left, right) J2A_PASTE2_(left, right)
#define J2A_PASTE3_(left, right) left##right
#define J2A_PASTE3(left, right) J2A_PASTE3_(left, right)
#define J2A_PASTE4_(left, right) left##right
#define J2A_PASTE4(left, right) J2A_PASTE4_(left, right)
#define J2A_PASTE5_(left, right) left##right
#define J2A_PASTE5(left, right) J2A_PASTE5_(left, right)
#define J2A_PASTE6_(left, right) left##right
#define J2A_PASTE6(left, right) J2A_PASTE6_(left, right)
#define J2A_PASTE7_(left, right) left##right
#define J2A_PASTE7(left, right) J2A_PASTE7_(left, right)

#define J2A_APPLY(macro, ...) macro(__VA_ARGS__)
#define J2A_STRIP(...) __VA_ARGS__
#define J2A_NOTHING(context, item)
#define J2A_FIRST_(first, ...) first
#define J2A_FIRST(...) J2A_FIRST_(__VA_ARGS__, ~)
#define J2A_SECOND_(first, second, ...) second
#define J2A_SECOND(...) J2A_SECOND_(__VA_ARGS__, ~)
#define J2A_INNER_SECOND_(first, second, ...) second
#define J2A_INNER_SECOND(...) J2A_INNER_SECOND_(__VA_ARGS__, ~)
#define J2A_THIRD_(first, second, third, ...) third

/* 1 if the item is in parentheses, else 0. */
#define J2A_PROBE_(...) ~, 1
#define J2A_IN_PARENTHESES(item) J2A_SECOND(J2A_PROBE_ item, 0)

/* ------------------------------------------------------------------------- each item ------ */

/* FIRST(context, item) NEXT(context, item) ... LAST(context, item): the last item is another one, such as the
 * text of a function. At most 33 items. */
#define J2A_EACH(FIRST, NEXT, LAST, context, ...) \
    J2A_PASTE1(J2A_EACH_, J2A_ONE_OR_MORE(__VA_ARGS__))(FIRST, NEXT, LAST, context, __VA_ARGS__)
#define J2A_EACH_ONE(FIRST, NEXT, LAST, context, item) LAST(context, item)
#define J2A_EACH_MORE(FIRST, NEXT, LAST, context, item, ...) \
    FIRST(context, item) J2A_REST(NEXT, LAST, context, __VA_ARGS__)
#define J2A_REST(NEXT, LAST, context, ...) \
    J2A_PASTE2(J2A_REST_, J2A_ITEMS(__VA_ARGS__))(NEXT, LAST, context, __VA_ARGS__)
#define J2A_ITEMS(...) J2A_ITEMS_(__VA_ARGS__, 33, 32, 31, 30, 29, 28, 27, 26, 25, 24, 23, 22, 21, 20, 19, 18, \
    17, 16, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)
#define J2A_ITEMS_(i1, i2, i3, i4, i5, i6, i7, i8, i9, i10, i11, i12, i13, i14, i15, i16, i17, i18, i19, i20, i21, \
    i22, i23, i24, i25, i26, i27, i28, i29, i30, i31, i32, i33, number, ...) number
#define J2A_ONE_OR_MORE(...) J2A_ITEMS_(__VA_ARGS__, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, \
    MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, MORE, \
    MORE, MORE, MORE, MORE, ONE, ~)
#define J2A_REST_1(N, L, c, item) L(c, item)
#define J2A_REST_2(N, L, c, item, ...) N(c, item) J2A_REST_1(N, L, c, __VA_ARGS__)
#define J2A_REST_3(N, L, c, item, ...) N(c, item) J2A_REST_2(N, L, c, __VA_ARGS__)
#define J2A_REST_4(N, L, c, item, ...) N(c, item) J2A_REST_3(N, L, c, __VA_ARGS__)
#define J2A_REST_5(N, L, c, item, ...) N(c, item) J2A_REST_4(N, L, c, __VA_ARGS__)
#define J2A_REST_6(N, L, c, item, ...) N(c, item) J2A_REST_5(N, L, c, __VA_ARGS__)
#define J2A_REST_7(N, L, c, item, ...) N(c, item) J2A_REST_6(N, L, c, __VA_ARGS__)
#define J2A_REST_8(N, L, c, item, ...) N(c, item) J2A_REST_7(N, L, c, __VA_ARGS__)
#define J2A_REST_9(N, L, c, item, ...) N(c, item) J2A_REST_8(N, L, c, __VA_ARGS__)
#define J2A_REST_10(N, L, c, item, ...) N(c, item) J2A_REST_9(N, L, c, __VA_ARGS__)
#define J2A_REST_11(N, L, c, item, ...) N(c, item) J2A_REST_10(N, L, c, __VA_ARGS__)
#define J2A_REST_12(N, L, c, item, ...) N(c, item) J2A_REST_11(N, L, c, __VA_ARGS__)
#define J2A_REST_13(N, L, c, item, ...) N(c, item) J2A_REST_12(N, L, c, __VA_ARGS__)
#define J2A_REST_14(N, L, c, item, ...) N(c, item) J2A_REST_13(N, L, c, __VA_ARGS__)
#define J2A_REST_15(N, L, c, item, ...) N(c, item) J2A_REST_14(N, L, c, __VA_ARGS__)
#define J2A_REST_16(N, L, c, item, ...) N(c, item) J2A_REST_15(N, L, c, __VA_ARGS__)
#define J2A_REST_17(N, L, c, item, ...) N(c, item) J2A_REST_16(N, L, c, __VA_ARGS__)
#define J2A_REST_18(N, L, c, item, ...) N(c, item) J2A_REST_17(N, L, c, __VA_ARGS__)
#define J2A_REST_19(N, L, c, item, ...) N(c, item) J2A_REST_18(N, L, c, __VA_ARGS__)
#define J2A_REST_20(N, L, c, item, ...) N(c, item) J2A_REST_19(N, L, c, __VA_ARGS__)
#define J2A_REST_21(N, L, c, item, ...) N(c, item) J2A_REST_20(N, L, c, __VA_ARGS__)
#define J2A_REST_22(N, L, c, item, ...) N(c, item) J2A_REST_21(N, L, c, __VA_ARGS__)
#define J2A_REST_23(N, L, c, item, ...) N(c, item) J2A_REST_22(N, L, c, __VA_ARGS__)
#define J2A_REST_24(N, L, c, item, ...) N(c, item) J2A_REST_23(N, L, c, __VA_ARGS__)
#define J2A_REST_25(N, L, c, item, ...) N(c, item) J2A_REST_24(N, L, c, __VA_ARGS__)
#define J2A_REST_26(N, L, c, item, ...) N(c, item) J2A_REST_25(N, L, c, __VA_ARGS__)
#define J2A_REST_27(N, L, c, item, ...) N(c, item) J2A_REST_26(N, L, c, __VA_ARGS__)
#define J2A_REST_28(N, L, c, item, ...) N(c, item) J2A_REST_27(N, L, c, __VA_ARGS__)
#define J2A_REST_29(N, L, c, item, ...) N(c, item) J2A_REST_28(N, L, c, __VA_ARGS__)
#define J2A_REST_30(N, L, c, item, ...) N(c, item) J2A_REST_29(N, L, c, __VA_ARGS__)
#define J2A_REST_31(N, L, c, item, ...) N(c, item) J2A_REST_30(N, L, c, __VA_ARGS__)
#define J2A_REST_32(N, L, c, item, ...) N(c, item) J2A_REST_31(N, L, c, __VA_ARGS__)
#define J2A_REST_33(N, L, c, item, ...) N(c, item) J2A_REST_32(N, L, c, __VA_ARGS__)

/* Parameters or arguments that each begin with a comma, behind a "~": in parentheses, without the first comma. */
#define J2A_PARAMETERS(...) J2A_PASTE3(J2A_PARAMETERS_, J2A_ONE_OR_MORE(__VA_ARGS__))(__VA_ARGS__)
#define J2A_PARAMETERS_ONE(none) (void)
#define J2A_PARAMETERS_MORE(none, ...) (__VA_ARGS__)
#define J2A_ARGUMENTS(...) J2A_PASTE3(J2A_ARGUMENTS_, J2A_ONE_OR_MORE(__VA_ARGS__))(__VA_ARGS__)
#define J2A_ARGUMENTS_ONE(none) ()
#define J2A_ARGUMENTS_MORE(none, ...) (__VA_ARGS__)

/* ------------------------------------------------------------------------- types ------ */

/* The form of a type: ONE value, a FIXED array, OPEN bytes, a LIST (an array of any number), or VOID. */
#define J2A_FORM(type) J2A_SECOND(J2A_PASTE4(J2A_FORM_, type), ONE)
#define J2A_FORM_void ~, VOID
#define J2A_FORM_text ~, OPEN
#define J2A_FORM_bytes ~, OPEN
#define J2A_FORM_array(...) ~, J2A_FORM_IN(J2A_THIRD_(__VA_ARGS__, FIXED, LIST, ~), J2A_FIRST(__VA_ARGS__))
#define J2A_FORM_IN(form, element) J2A_FORM_IN_(form, element)
#define J2A_FORM_IN_(form, element) J2A_INNER_SECOND(J2A_##form##_##element, form)
#define J2A_FIXED_text ~, OPEN
#define J2A_FIXED_bytes ~, OPEN
#define J2A_LIST_u8 ~, OPEN
#define J2A_LIST_i8 ~, OPEN

/* Of an array the element and the length; the longest one that a payload holds where the type has none. */
#define J2A_ELEMENT(type) J2A_SECOND(J2A_PASTE4(J2A_ELEMENT_, type), type)
#define J2A_ELEMENT_array(...) ~, J2A_FIRST(__VA_ARGS__)
#define J2A_LENGTH(type) J2A_SECOND(J2A_PASTE4(J2A_LENGTH_, type), 255)
#define J2A_LENGTH_array(...) ~, J2A_INNER_SECOND(__VA_ARGS__, 255)

/* What stands in an interface: i32, text[16], i16[]. */
#define J2A_SPELL(type) J2A_SECOND(J2A_PASTE4(J2A_SPELL_, type), J2A_STRING(type))
#define J2A_SPELL__Bool ~, "bool" /* what C99 makes of bool */
#define J2A_SPELL_array(...) ~, J2A_SPELL_ARRAY(J2A_FIRST(__VA_ARGS__), J2A_INNER_SECOND(__VA_ARGS__, ))
#define J2A_SPELL_ARRAY(element, length) J2A_SPELL_ARRAY_(element, length)
#define J2A_SPELL_ARRAY_(element, length) \
    J2A_INNER_SECOND(J2A_SPELL_##element, J2A_STRING(element)) "[" J2A_STRING(length) "]"
#define J2A_STRING_(text) #text
#define J2A_STRING(text) J2A_STRING_(text)

/* MACRO_ONE, MACRO_FIXED ... (element, name, length) for the field (type, name) or (type, name, unit). */
#define J2A_BY_FORM(macro, type, ...) J2A_APPLY(J2A_PASTE5(macro, J2A_FORM(type)), J2A_ELEMENT(type), \
    J2A_FIRST(__VA_ARGS__), J2A_LENGTH(type))

/* macro(type, name, ...) if the item is a field, else nothing. */
#define J2A_IF_FIELD(macro, item) J2A_PASTE6(J2A_IF_FIELD_, J2A_IN_PARENTHESES(item))(macro, item)
#define J2A_IF_FIELD_0(macro, item)
#define J2A_IF_FIELD_1(macro, item) macro item

/* The unit of the field (type, name, unit) as text behind its type, given name, unit. */
#define J2A_UNIT_TEXT(...) J2A_PASTE3(J2A_UNIT_, J2A_ONE_OR_MORE(__VA_ARGS__))(__VA_ARGS__)
#define J2A_UNIT_ONE(name)
#define J2A_UNIT_MORE(name, unit) " " J2A_STRING(unit)

/* Fields in parentheses, and lines of definitions (SPEC.md, section 20). */
#define J2A_FIRST_FIELD(none, item) J2A_IF_FIELD(J2A_FIELD_TEXT, item)
#define J2A_NEXT_FIELD(none, item) J2A_IF_FIELD(J2A_NEXT_TEXT, item)
#define J2A_FIELD_TEXT(type, ...) J2A_STRING(J2A_FIRST(__VA_ARGS__)) " " J2A_SPELL(type) J2A_UNIT_TEXT(__VA_ARGS__)
#define J2A_NEXT_TEXT(type, ...) ", " J2A_FIELD_TEXT(type, __VA_ARGS__)
#define J2A_FIELD_LIST(...) "(" J2A_EACH(J2A_FIRST_FIELD, J2A_NEXT_FIELD, J2A_NOTHING, ~, __VA_ARGS__) ")"
#define J2A_FIRST_VALUE(none, item) J2A_APPLY(J2A_VALUE_TEXT, J2A_STRIP item)
#define J2A_NEXT_VALUE(none, item) ", " J2A_APPLY(J2A_VALUE_TEXT, J2A_STRIP item)
#define J2A_VALUE_TEXT(value, number) J2A_STRING(value) "=" J2A_STRING(number)
#define J2A_ENUM_TEXT(name, integer, ...) \
    "enum " #name " " #integer " (" J2A_EACH(J2A_FIRST_VALUE, J2A_NEXT_VALUE, J2A_NOTHING, ~, __VA_ARGS__, "") ")\n"
#define J2A_STRUCT_TEXT(name, ...) "struct " #name " " J2A_FIELD_LIST(__VA_ARGS__, "") "\n"

/* ------------------------------------------------------------------------- results ------ */

/* A result is void, TYPE, (TYPE, unit) or ((TYPE, name), (TYPE, name, unit), ...). Its shape is the form of its
 * type, or NAMED for the last one; HEAD is what stands first in it. */
#define J2A_HEAD(result) J2A_PASTE1(J2A_HEAD_, J2A_IN_PARENTHESES(result))(result)
#define J2A_HEAD_0(result) result
#define J2A_HEAD_1(result) J2A_FIRST result
#define J2A_SHAPE(result) J2A_SHAPE_OF(J2A_HEAD(result))
#define J2A_SHAPE_OF(head) J2A_PASTE2(J2A_SHAPE_, J2A_IN_PARENTHESES(head))(head)
#define J2A_SHAPE_0(head) J2A_FORM(head)
#define J2A_SHAPE_1(head) NAMED
#define J2A_BY_SHAPE(macro, result) J2A_APPLY_SHAPE(J2A_PASTE7(macro, J2A_SHAPE(result)), result)
#define J2A_APPLY_SHAPE(macro, result) macro(result)

/* The results that the function gets pointers for, as items with a last one that is none. */
#define J2A_OUTPUTS(result) J2A_BY_SHAPE(J2A_OUTPUTS_, result)
#define J2A_OUTPUTS_VOID(r) ""
#define J2A_OUTPUTS_ONE(r) ""
#define J2A_OUTPUTS_FIXED(r) (J2A_HEAD(r), result), ""
#define J2A_OUTPUTS_OPEN(r) (J2A_HEAD(r), result), ""
#define J2A_OUTPUTS_LIST(r) (J2A_HEAD(r), result), ""
#define J2A_OUTPUTS_NAMED(r) J2A_STRIP r, ""

#endif
