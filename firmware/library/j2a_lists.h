/* Functions and properties as lists in one of the user's own files, without functions.def and
 * properties.def. In: two lists, each once in the whole image, at file scope, in C99 or C++:
 *   J2A_FUNCTIONS(J2A_CALL(add, my_add), J2A_MANY(store, my_store))
 *   J2A_PROPERTIES(J2A_PROPERTY("name", "My board"))
 * In C++ functions may be plain ones, whose types the compiler finds (see j2a_deduced.h):
 *   J2A_FUNCTIONS(J2A_FUNCTION(add, "a b: Adds two numbers."),  int32_t add(int32_t a, int32_t b)
 *                 J2A_BUFFER(config, "Kept."),                  uint8_t config[400]
 *                 J2A_SIF(report, "time(ms) value: A reading.")) j2a::sif<32, uint32_t, uint16_t> report
 * Out: the tables that the core expects. Opcodes are in the order of the list, after the built-in functions;
 * without a2jMany (J2A_WITH_MANY 0) a J2A_MANY or J2A_BUFFER has none, and is as if it were not in the list.
 * j2a.spec belongs to each device and is the first property. Lists may be empty, may end in a comma, and
 * hold 64 items; beyond that functions.def is the way.
 * Rules: names that are macros are replaced first. A function of the wrong kind, a name or key that is
 * empty, a name that comes twice and names too long for a payload do not compile. That keys do not repeat is
 * the user's care in C; in C++ the compiler sees it. */
#ifndef J2A_LISTS_H
#define J2A_LISTS_H

#include "j2a_deduced.h"
#include "j2a_table.h"

/* J2A_EACH_(WHAT, item, item, ...) gives WHAT_item WHAT_item ...: an item such as J2A_CALL(add, my_add) is
 * no macro, and becomes one when WHAT_ is put before it. An item that is empty gives WHAT_ alone, so that is
 * a macro, too. A macro is not replaced within itself, so there is one for each number of items that is
 * left. */
#define J2A_EACH_(what, ...) J2A_JOIN_(J2A_EACH_, J2A_COUNT_(__VA_ARGS__))(what, __VA_ARGS__)
#define J2A_JOIN_(left, right) J2A_JOINED_(left, right)
#define J2A_JOINED_(left, right) left##right
#define J2A_COUNT_(...) J2A_NUMBER_65_(__VA_ARGS__, 64, 63, 62, 61, 60, 59, 58, 57, 56, 55, 54, 53, 52, \
    51, 50, 49, 48, 47, 46, 45, 44, 43, 42, 41, 40, 39, 38, 37, 36, 35, 34, 33, 32, 31, 30, 29, 28, 27, \
    26, 25, 24, 23, 22, 21, 20, 19, 18, 17, 16, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)
#define J2A_NUMBER_65_(i1, i2, i3, i4, i5, i6, i7, i8, i9, i10, i11, i12, i13, i14, i15, i16, i17, i18, \
    i19, i20, i21, i22, i23, i24, i25, i26, i27, i28, i29, i30, i31, i32, i33, i34, i35, i36, i37, i38, \
    i39, i40, i41, i42, i43, i44, i45, i46, i47, i48, i49, i50, i51, i52, i53, i54, i55, i56, i57, i58, \
    i59, i60, i61, i62, i63, i64, number, ...) number
#define J2A_EACH_1(what, item) what##_##item
#define J2A_EACH_2(what, item, ...) what##_##item J2A_EACH_1(what, __VA_ARGS__)
#define J2A_EACH_3(what, item, ...) what##_##item J2A_EACH_2(what, __VA_ARGS__)
#define J2A_EACH_4(what, item, ...) what##_##item J2A_EACH_3(what, __VA_ARGS__)
#define J2A_EACH_5(what, item, ...) what##_##item J2A_EACH_4(what, __VA_ARGS__)
#define J2A_EACH_6(what, item, ...) what##_##item J2A_EACH_5(what, __VA_ARGS__)
#define J2A_EACH_7(what, item, ...) what##_##item J2A_EACH_6(what, __VA_ARGS__)
#define J2A_EACH_8(what, item, ...) what##_##item J2A_EACH_7(what, __VA_ARGS__)
#define J2A_EACH_9(what, item, ...) what##_##item J2A_EACH_8(what, __VA_ARGS__)
#define J2A_EACH_10(what, item, ...) what##_##item J2A_EACH_9(what, __VA_ARGS__)
#define J2A_EACH_11(what, item, ...) what##_##item J2A_EACH_10(what, __VA_ARGS__)
#define J2A_EACH_12(what, item, ...) what##_##item J2A_EACH_11(what, __VA_ARGS__)
#define J2A_EACH_13(what, item, ...) what##_##item J2A_EACH_12(what, __VA_ARGS__)
#define J2A_EACH_14(what, item, ...) what##_##item J2A_EACH_13(what, __VA_ARGS__)
#define J2A_EACH_15(what, item, ...) what##_##item J2A_EACH_14(what, __VA_ARGS__)
#define J2A_EACH_16(what, item, ...) what##_##item J2A_EACH_15(what, __VA_ARGS__)
#define J2A_EACH_17(what, item, ...) what##_##item J2A_EACH_16(what, __VA_ARGS__)
#define J2A_EACH_18(what, item, ...) what##_##item J2A_EACH_17(what, __VA_ARGS__)
#define J2A_EACH_19(what, item, ...) what##_##item J2A_EACH_18(what, __VA_ARGS__)
#define J2A_EACH_20(what, item, ...) what##_##item J2A_EACH_19(what, __VA_ARGS__)
#define J2A_EACH_21(what, item, ...) what##_##item J2A_EACH_20(what, __VA_ARGS__)
#define J2A_EACH_22(what, item, ...) what##_##item J2A_EACH_21(what, __VA_ARGS__)
#define J2A_EACH_23(what, item, ...) what##_##item J2A_EACH_22(what, __VA_ARGS__)
#define J2A_EACH_24(what, item, ...) what##_##item J2A_EACH_23(what, __VA_ARGS__)
#define J2A_EACH_25(what, item, ...) what##_##item J2A_EACH_24(what, __VA_ARGS__)
#define J2A_EACH_26(what, item, ...) what##_##item J2A_EACH_25(what, __VA_ARGS__)
#define J2A_EACH_27(what, item, ...) what##_##item J2A_EACH_26(what, __VA_ARGS__)
#define J2A_EACH_28(what, item, ...) what##_##item J2A_EACH_27(what, __VA_ARGS__)
#define J2A_EACH_29(what, item, ...) what##_##item J2A_EACH_28(what, __VA_ARGS__)
#define J2A_EACH_30(what, item, ...) what##_##item J2A_EACH_29(what, __VA_ARGS__)
#define J2A_EACH_31(what, item, ...) what##_##item J2A_EACH_30(what, __VA_ARGS__)
#define J2A_EACH_32(what, item, ...) what##_##item J2A_EACH_31(what, __VA_ARGS__)
#define J2A_EACH_33(what, item, ...) what##_##item J2A_EACH_32(what, __VA_ARGS__)
#define J2A_EACH_34(what, item, ...) what##_##item J2A_EACH_33(what, __VA_ARGS__)
#define J2A_EACH_35(what, item, ...) what##_##item J2A_EACH_34(what, __VA_ARGS__)
#define J2A_EACH_36(what, item, ...) what##_##item J2A_EACH_35(what, __VA_ARGS__)
#define J2A_EACH_37(what, item, ...) what##_##item J2A_EACH_36(what, __VA_ARGS__)
#define J2A_EACH_38(what, item, ...) what##_##item J2A_EACH_37(what, __VA_ARGS__)
#define J2A_EACH_39(what, item, ...) what##_##item J2A_EACH_38(what, __VA_ARGS__)
#define J2A_EACH_40(what, item, ...) what##_##item J2A_EACH_39(what, __VA_ARGS__)
#define J2A_EACH_41(what, item, ...) what##_##item J2A_EACH_40(what, __VA_ARGS__)
#define J2A_EACH_42(what, item, ...) what##_##item J2A_EACH_41(what, __VA_ARGS__)
#define J2A_EACH_43(what, item, ...) what##_##item J2A_EACH_42(what, __VA_ARGS__)
#define J2A_EACH_44(what, item, ...) what##_##item J2A_EACH_43(what, __VA_ARGS__)
#define J2A_EACH_45(what, item, ...) what##_##item J2A_EACH_44(what, __VA_ARGS__)
#define J2A_EACH_46(what, item, ...) what##_##item J2A_EACH_45(what, __VA_ARGS__)
#define J2A_EACH_47(what, item, ...) what##_##item J2A_EACH_46(what, __VA_ARGS__)
#define J2A_EACH_48(what, item, ...) what##_##item J2A_EACH_47(what, __VA_ARGS__)
#define J2A_EACH_49(what, item, ...) what##_##item J2A_EACH_48(what, __VA_ARGS__)
#define J2A_EACH_50(what, item, ...) what##_##item J2A_EACH_49(what, __VA_ARGS__)
#define J2A_EACH_51(what, item, ...) what##_##item J2A_EACH_50(what, __VA_ARGS__)
#define J2A_EACH_52(what, item, ...) what##_##item J2A_EACH_51(what, __VA_ARGS__)
#define J2A_EACH_53(what, item, ...) what##_##item J2A_EACH_52(what, __VA_ARGS__)
#define J2A_EACH_54(what, item, ...) what##_##item J2A_EACH_53(what, __VA_ARGS__)
#define J2A_EACH_55(what, item, ...) what##_##item J2A_EACH_54(what, __VA_ARGS__)
#define J2A_EACH_56(what, item, ...) what##_##item J2A_EACH_55(what, __VA_ARGS__)
#define J2A_EACH_57(what, item, ...) what##_##item J2A_EACH_56(what, __VA_ARGS__)
#define J2A_EACH_58(what, item, ...) what##_##item J2A_EACH_57(what, __VA_ARGS__)
#define J2A_EACH_59(what, item, ...) what##_##item J2A_EACH_58(what, __VA_ARGS__)
#define J2A_EACH_60(what, item, ...) what##_##item J2A_EACH_59(what, __VA_ARGS__)
#define J2A_EACH_61(what, item, ...) what##_##item J2A_EACH_60(what, __VA_ARGS__)
#define J2A_EACH_62(what, item, ...) what##_##item J2A_EACH_61(what, __VA_ARGS__)
#define J2A_EACH_63(what, item, ...) what##_##item J2A_EACH_62(what, __VA_ARGS__)
#define J2A_EACH_64(what, item, ...) what##_##item J2A_EACH_63(what, __VA_ARGS__)

/* Is the function of the kind given in the list? C compares two declarations. C++ would take the second for
 * another function of the same name, so there it is given to one that takes only this kind. */
#ifdef __cplusplus
char j2a_needs_a_call(j2a_call_fn *function);
char j2a_needs_a_many(j2a_many_fn *function);
#define J2A_KIND_OF_J2A_CALL(name, function) extern char j2a_kind_checked[sizeof j2a_needs_a_call(function)];
#define J2A_KIND_OF_J2A_MANY(name, function) extern char j2a_kind_checked[sizeof j2a_needs_a_many(function)];
#else
#define J2A_KIND_OF_J2A_CALL(name, function) j2a_call_fn function;
#define J2A_KIND_OF_J2A_MANY(name, function) j2a_many_fn function;
#endif
#define J2A_KIND_OF_

#define J2A_NAME_OF_J2A_CALL(name, function) J2A_NAMED(function, name)
#define J2A_NAME_OF_

#define J2A_ENTRY_OF_J2A_CALL(name, function) J2A_CALL_ENTRY(name, function)
#define J2A_ENTRY_OF_


/* Nobody could call a function of kind many without a2jMany, so it gets no name and no opcode then. The
 * pointer, which compilers leave out, keeps them from warning of a static function without use. */
#if J2A_WITH_MANY
#define J2A_NAME_OF_J2A_MANY(name, function) J2A_NAMED(function, name)
#define J2A_ENTRY_OF_J2A_MANY(name, function) J2A_MANY_ENTRY(name, function)
#define J2A_SIZE_OF_J2A_MANY(name, function) + sizeof #name
#else
#ifdef __GNUC__
#define J2A_NAME_OF_J2A_MANY(name, function) \
    static j2a_many_fn *const j2a_kept_##name __attribute__((unused)) = function;
#else
#define J2A_NAME_OF_J2A_MANY(name, function)
#endif
#define J2A_ENTRY_OF_J2A_MANY(name, function)
#define J2A_SIZE_OF_J2A_MANY(name, function)
#endif

/* What a C++ compiler finds out itself. */
#ifdef __cplusplus
#define J2A_MEMBER_OF_J2A_CALL(name, function)
#define J2A_CASE_OF_J2A_CALL(name, function)
#define J2A_DEFINITION_OF_J2A_CALL(name, function)
#define J2A_MEMBER_OF_J2A_MANY(name, function)
#define J2A_CASE_OF_J2A_MANY(name, function)
#define J2A_DEFINITION_OF_J2A_MANY(name, function)
#define J2A_MEMBER_OF_
#define J2A_CASE_OF_
#define J2A_DEFINITION_OF_
#if J2A_WITH_INTERFACE
#define J2A_WRITE_NAME_(target) J2A_WRITE_LINE_(target)
#else
#define J2A_WRITE_NAME_(target) static constexpr j2a::characters<sizeof #target> J2A_FLASH j2a_map_of_##target = {#target};
#endif
#if J2A_WITH_MAPPING
#define J2A_TYPED_NAME_(target) enum { j2a_name_##target }; J2A_WRITE_NAME_(target)
#define J2A_TYPED_ENTRY_(target, function, kind) {(j2a_function)(function), j2a_map_of_##target.of J2A_OF_KIND(kind)},
#else
#define J2A_TYPED_NAME_(target)
#define J2A_TYPED_ENTRY_(target, function, kind) {(j2a_function)(function) J2A_OF_KIND(kind)},
#endif

#define J2A_KIND_OF_J2A_FUNCTION(function, text) J2A_CHECK_TEXT_(j2a::describe<decltype(&function)>, function, text)
#define J2A_NAME_OF_J2A_FUNCTION(function, text) J2A_TYPED_NAME_(function)
#define J2A_ENTRY_OF_J2A_FUNCTION(target, text) \
    J2A_TYPED_ENTRY_(target, &j2a::function<decltype(&target)>::call<&target>, J2A_KIND_CALL)
#define J2A_SIZE_OF_J2A_FUNCTION(function, text) + sizeof #function
#define J2A_MEMBER_OF_J2A_FUNCTION(function, text)
#define J2A_CASE_OF_J2A_FUNCTION(function, text)
#define J2A_DEFINITION_OF_J2A_FUNCTION(function, text)

#define J2A_KIND_OF_J2A_BUFFER(array, text) J2A_CHECK_TEXT_(j2a::memory<decltype(array)>, array, text)
#define J2A_MEMBER_OF_J2A_BUFFER(array, text)
#define J2A_CASE_OF_J2A_BUFFER(array, text)
#define J2A_DEFINITION_OF_J2A_BUFFER(array, text)
#if J2A_WITH_MANY
#define J2A_NAME_OF_J2A_BUFFER(array, text) J2A_TYPED_NAME_(array)
#define J2A_ENTRY_OF_J2A_BUFFER(array, text) \
    J2A_TYPED_ENTRY_(array, &j2a::memory<decltype(array)>::many<&array>, J2A_KIND_MANY)
#define J2A_SIZE_OF_J2A_BUFFER(array, text) + sizeof #array
#else
#define J2A_NAME_OF_J2A_BUFFER(array, text)
#define J2A_ENTRY_OF_J2A_BUFFER(array, text)
#define J2A_SIZE_OF_J2A_BUFFER(array, text)
#endif

#define J2A_NAME_OF_J2A_SIF(sif, text)
#define J2A_ENTRY_OF_J2A_SIF(sif, text)
#define J2A_SIZE_OF_J2A_SIF(sif, text)
#if J2A_WITH_SIF && J2A_WITH_INTERFACE
#define J2A_KIND_OF_J2A_SIF(sif, text) \
    J2A_CHECK_TEXT_(j2a::describe_sif<decltype(sif)>, sif, text) \
    static_assert(sizeof #sif <= 33, "J2A: " #sif ": the name of a SIF has at most 32 characters"); \
    static_assert(j2a::is_last(j2a::flag_at(j2a_line_of_##sif.words(), 0)), "J2A: " #sif ": a SIF has no flags"); \
    J2A_CHECK_SENSORS_(sif) \
    J2A_WRITE_DEFINITION_(sif)
#define J2A_MEMBER_OF_J2A_SIF(sif, text) decltype(j2a_map_of_##sif) of_##sif;
#define J2A_CASE_OF_J2A_SIF(sif, text) case decltype(sif)::number:
#define J2A_DEFINITION_OF_J2A_SIF(sif, text) j2a_map_of_##sif,
#else
#define J2A_KIND_OF_J2A_SIF(sif, text)
#define J2A_MEMBER_OF_J2A_SIF(sif, text)
#define J2A_CASE_OF_J2A_SIF(sif, text)
#define J2A_DEFINITION_OF_J2A_SIF(sif, text)
#endif
#endif

/* Definitions are written one behind the other. */
#if J2A_WITH_INTERFACE && defined(__cplusplus)
#define J2A_DEFINITIONS_(...) \
    inline void j2a_each_sif_has_its_own_opcode(int opcode) { \
        switch (opcode) { \
            J2A_EACH_(J2A_CASE_OF, __VA_ARGS__) \
        default: \
            break; \
        } \
    } \
    static const struct { \
        J2A_EACH_(J2A_MEMBER_OF, __VA_ARGS__) \
        char end; \
    } J2A_FLASH j2a_written_definitions = {J2A_EACH_(J2A_DEFINITION_OF, __VA_ARGS__) '\0'}; \
    const char *j2a_definitions(void) { \
        return reinterpret_cast<const char *>(&j2a_written_definitions); \
    }
#else
#define J2A_DEFINITIONS_(...) J2A_NO_DEFINITIONS
#endif

/* The map must fit into one frame: a negative array size stops the build when it does not. */
#if J2A_WITH_MAPPING && !J2A_WITH_INTERFACE
#define J2A_SIZE_OF_J2A_CALL(name, function) + sizeof #name
#define J2A_SIZE_OF_
#define J2A_CHECK_SIZE_(...) \
    extern char j2a_names_longer_than_a_payload[ \
        J2A_BUILTIN_SIZE J2A_EACH_(J2A_SIZE_OF, __VA_ARGS__) <= J2A_ROOM ? 1 : -1];
#else
#define J2A_CHECK_SIZE_(...)
#endif

/* Transducers that an application lists apart from the core bring their functions, and opcodes of SIFs. */
#define J2A_CHECK_SENSORS_(sif)
#if !J2A_TRANSDUCERS_APART
#define J2A_FUNCTIONS J2A_TABLE_
#elif J2A_WITH_TRANSDUCERS
#undef J2A_CHECK_SENSORS_
#define J2A_CHECK_SENSORS_(sif) \
    static_assert(!j2a::is_sensor(decltype(sif)::number), "J2A: " #sif ": its opcode is the id of a sensor");
#define J2A_FUNCTIONS(...) \
    J2A_TABLE_(J2A_MANY(a2jGetTransds, j2a_get_transds), J2A_CALL(a2jTransd, j2a_transd), __VA_ARGS__)
#else
#define J2A_FUNCTIONS(...) \
    static_assert(sizeof J2A_TEXT(J2A_TRANSDUCERS) == sizeof "J2A_TRANSDUCERS", \
                  "#define J2A_TRANSDUCERS must stand before #include <J2A.h>"); \
    J2A_TABLE_(__VA_ARGS__)
#endif

#define J2A_TABLE_(...) \
    J2A_EACH_(J2A_KIND_OF, __VA_ARGS__) \
    J2A_EACH_(J2A_NAME_OF, __VA_ARGS__) \
    J2A_CHECK_SIZE_(__VA_ARGS__) \
    J2A_TABLE_BEGIN J2A_EACH_(J2A_ENTRY_OF, __VA_ARGS__) J2A_TABLE_END J2A_DEFINITIONS_(__VA_ARGS__) \
    extern const uint8_t j2a_function_count /* takes the semicolon of the user */

#define J2A_VALUE_OF_J2A_PROPERTY(key, value) key "\0" value "\0"
#define J2A_VALUE_OF_
#define J2A_FULL_OF_J2A_PROPERTY(key, value) \
    extern char j2a_property_is_empty[sizeof key > 1 && sizeof value > 1 ? 1 : -1];
#define J2A_FULL_OF_

/* In C++ a key that comes twice does not compile. */
#ifdef __cplusplus
#define J2A_KEYS_OF_J2A_PROPERTY(key, value) key,
#define J2A_KEYS_OF_
#define J2A_CHECK_KEYS_(...) \
    static constexpr const char *j2a_keys[] = {"j2a.spec", "j2a.room", "j2a.caps", "j2a.interface", "j2a.selftest", \
                                               J2A_EACH_(J2A_KEYS_OF, __VA_ARGS__) ""}; \
    static_assert(!j2a::is_a_key_twice(j2a_keys, 0), "J2A_PROPERTIES: a key comes twice, or is one of J2A's own");
#else
#define J2A_CHECK_KEYS_(...)
#endif

#if J2A_WITH_PROPERTIES
#define J2A_PROPERTIES(...) \
    J2A_CHECK_KEYS_(__VA_ARGS__) \
    J2A_EACH_(J2A_FULL_OF, __VA_ARGS__) \
    const unsigned char J2A_FLASH j2a_properties[] = J2A_PROPERTY_ROOM J2A_PROPERTY_CAPS "j2a.spec\0" J2A_SPEC_VERSION "\0" \
        J2A_EACH_(J2A_VALUE_OF, __VA_ARGS__); \
    extern const unsigned char j2a_properties[]
#else
#define J2A_PROPERTIES(...) extern const unsigned char j2a_properties[]
#endif

#endif
