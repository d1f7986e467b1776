/* Builds the table of transducers and their descriptors from the application's transds.def (see transds.h): what is
 * kept of each in RAM, the callbacks of their drivers, and the text that a2jGetTransds returns. */
#include "j2a_transds.h"

#if J2A_WITH_TRANSDUCERS
#include "transds.h"

/* ------------------------------------------------------------------------- keys ------ */

/* What the items of a transducer say of one key, such as + (4) for queue, (queue, 4); nothing without that key. */
#define J2A_KEY(which, item) J2A_PASTE6(J2A_KEY_, J2A_IN_PARENTHESES(item))(which, item)
#define J2A_KEY_0(which, item)
#define J2A_KEY_1(which, item) J2A_APPLY(J2A_KEY_OF, which, J2A_STRIP item)
#define J2A_KEY_OF(which, ...) J2A_PASTE3(J2A_KEY_OF_, J2A_ONE_OR_MORE(__VA_ARGS__))(which, __VA_ARGS__)
#define J2A_KEY_OF_ONE(which, key) J2A_KEY_VALUE(which, key, 1)
#define J2A_KEY_OF_MORE(which, key, ...) J2A_KEY_VALUE(which, key, __VA_ARGS__)
#define J2A_KEY_VALUE(which, key, ...) J2A_INNER_SECOND(J2A_SAYS_##which##_##key, J2A_NO_KEY)(__VA_ARGS__)
#define J2A_NO_KEY(...)
#define J2A_ADD(number) + (number)
#define J2A_ADD_ONE(...) + 1
#define J2A_ADD_TEXT(...) #__VA_ARGS__
#define J2A_SAYS_period_period ~, J2A_ADD
#define J2A_SAYS_enabled_enabled ~, J2A_ADD
#define J2A_SAYS_disabled_enabled ~, J2A_ADD_DISABLED
#define J2A_ADD_DISABLED(number) + !(number)
#define J2A_SAYS_queue_queue ~, J2A_ADD
#define J2A_SAYS_queued_queue ~, J2A_ADD_ONE
#define J2A_SAYS_decimation_decimation ~, J2A_ADD
#define J2A_SAYS_decimated_decimation ~, J2A_ADD_ONE
#define J2A_SAYS_threshold_threshold ~, J2A_ADD_ONE
#define J2A_SAYS_range_range ~, J2A_ADD_ONE
#define J2A_SAYS_reversed_range ~, J2A_ADD_REVERSED
/* Not low > high, which compilers warn of where it is 0 and the other one unsigned. */
#define J2A_ADD_REVERSED(low, high) + !(0LL + (low) < 0LL + (high) || (low) == (high))
#define J2A_SAYS_topic_topic ~, J2A_ADD_ONE
#define J2A_SAYS_topictext_topic ~, J2A_ADD_TEXT
#define J2A_SAYS_trigger_trigger ~, J2A_ADD_ONE
#define J2A_SAYS_guarded_watchdog ~, J2A_ADD_ONE
#define J2A_SAYS_watchdog_watchdog ~, J2A_ADD
#define J2A_SAYS_raw_threshold ~, J2A_CASE_THRESHOLD
#define J2A_SAYS_raw_range ~, J2A_CASE_RANGE
#define J2A_CASE_THRESHOLD(number) \
    case J2A_RAW_THRESHOLD: \
        value = (number); \
        break;
#define J2A_CASE_RANGE(low, high) \
    case J2A_RAW_LOW: \
        value = (low); \
        break; \
    case J2A_RAW_HIGH: \
        value = (high); \
        break;
#define J2A_SAYS_unit_unit ~, J2A_ADD_UNIT
#define J2A_ADD_UNIT(...) " " #__VA_ARGS__
#define J2A_SAY(which, ...) J2A_EACH(J2A_KEY, J2A_KEY, J2A_NOTHING, which, __VA_ARGS__)

/* An enumerator for each key, so that one that comes twice is an error. */
#define J2A_ONCE(name, item) J2A_PASTE6(J2A_ONCE_, J2A_IN_PARENTHESES(item))(name, item)
#define J2A_ONCE_0(name, item)
#define J2A_ONCE_1(name, item) J2A_APPLY(J2A_ONCE_KEY, name, J2A_FIRST item)
#define J2A_ONCE_KEY(name, key) the_key_##key##_of_##name,

/* ------------------------------------------------------------------------- types ------ */

/* How values of a type are ordered: none of arrays, which have no raw values. Whether a name is that of an enumeration,
 * which has the order of its integer, or of a structure, which has none, is known to the compiler only. */
#define J2A_ORDER(type) J2A_SECOND(J2A_PASTE4(J2A_ORDER_, type), named(type))
#define J2A_ORDER_array(...) ~, none
#define J2A_ORDER__Bool ~, unsigned
#define J2A_ORDER_bool ~, unsigned
#define J2A_ORDER_u8 ~, unsigned
#define J2A_ORDER_u16 ~, unsigned
#define J2A_ORDER_u32 ~, unsigned
#define J2A_ORDER_u64 ~, unsigned
#define J2A_ORDER_i8 ~, signed
#define J2A_ORDER_i16 ~, signed
#define J2A_ORDER_i32 ~, signed
#define J2A_ORDER_i64 ~, signed
#define J2A_ORDER_f32 ~, f32
#define J2A_ORDER_f64 ~, f64
#define J2A_COMPARE(order) J2A_INNER_SECOND(J2A_COMPARE_##order, j2a_compare_##order)
#define J2A_COMPARE_none ~, 0
#define J2A_COMPARE_named(type) ~, J2A_BY_SIGN(type, j2a_compare)
#define J2A_NEAR(order) J2A_INNER_SECOND(J2A_NEAR_##order, j2a_near_##order)
#define J2A_NEAR_none ~, 0
#define J2A_NEAR_named(type) ~, J2A_BY_SIGN(type, j2a_near)
#define J2A_BY_SIGN(type, function) \
    (!j2a_has_raw_##type ? 0 : (j2a_c_raw_##type)-1 > 0 ? function##_unsigned : function##_signed)
#define J2A_HAS_RAW(order) J2A_INNER_SECOND(J2A_HAS_RAW_##order, 1)
#define J2A_HAS_RAW_none ~, 0
#define J2A_HAS_RAW_named(type) ~, j2a_has_raw_##type
#define J2A_OF_ORDER(macro, type) macro(type)

/* The raw values that a transds.def gives: puts one into `to`, returns false where it gives none. */
#define J2A_RAW(name, type, na, ...) J2A_PASTE7(J2A_RAW_OF_, J2A_ORDER(type))(name, type, na, __VA_ARGS__)
#define J2A_RAW_OF_unsigned(name, type, na, ...) \
    J2A_RAW_FUNCTION(J2A_IN_ORDER(__VA_ARGS__), name, type, na, __VA_ARGS__)
#define J2A_RAW_OF_signed J2A_RAW_OF_unsigned
#define J2A_RAW_OF_f32(name, type, na, ...) J2A_RAW_FUNCTION(J2A_NAN, name, type, na, __VA_ARGS__)
#define J2A_RAW_OF_f64(name, type, na, ...) J2A_RAW_FUNCTION(J2A_NAN, name, type, na, __VA_ARGS__)
#define J2A_RAW_OF_none(name, type, na, ...)
#define J2A_RAW_OF_named(type) J2A_RAW_OF_NAMED
#define J2A_RAW_OF_NAMED(name, type, na, ...) \
    J2A_RAW_FUNCTION(J2A_IN_ORDER(__VA_ARGS__), name, raw_##type, na, __VA_ARGS__)
#define J2A_RAW_OR_NOT(order, name) \
    J2A_INNER_SECOND(J2A_RAW_OR_NOT_##order, (J2A_HAS_RAW(order) ? j2a_raw_of_##name : 0))
#define J2A_RAW_OR_NOT_none ~, 0
#define J2A_IS_NONE(text) (sizeof text == 5 && text[0] == 'n' && text[1] == 'o')
/* Of integers: no comparison of floating-point numbers is an integer constant expression. */
#define J2A_IN_ORDER(...) \
    enum { the_lowest_value_of_range_comes_first = 1 / !(0 J2A_SAY(reversed, __VA_ARGS__)) };
#define J2A_NAN \
    const float nan = 0.0f / 0.0f; \
    (void)nan;
#define J2A_RAW_FUNCTION(names, name, type, na, ...) \
    static bool j2a_raw_of_##name(uint8_t which, uint8_t *to) { \
        enum { none }; \
        names \
        j2a_c_##type value; \
        switch (which) { \
        case J2A_RAW_NA: \
            if (J2A_IS_NONE(#na)) \
                return false; \
            value = (na); \
            break; \
            J2A_SAY(raw, __VA_ARGS__) \
        default: \
            return false; \
        } \
        (void)none; \
        j2a_put_##type(to, value); \
        return true; \
    }

/* A value between its bytes and its type. */
#define J2A_PUT_VALUE(none, item) J2A_IF_FIELD(J2A_PUT_VALUE_OF, item)
#define J2A_PUT_VALUE_OF(type, ...) J2A_BY_FORM(J2A_PUT_VALUE_, type, __VA_ARGS__)
#define J2A_PUT_VALUE_ONE(element, name, n) j2a_put_##element(bytes, in_##name);
#define J2A_PUT_VALUE_FIXED(element, name, n) \
    uint8_t i; \
    for (i = 0; i < (n); i++) \
        j2a_put_##element(bytes + i * j2a_size_##element, j2a_as_##element(&in_##name[i]));
#define J2A_TAKE_VALUE(none, item) J2A_IF_FIELD(J2A_TAKE_VALUE_OF, item)
#define J2A_TAKE_VALUE_OF(type, ...) J2A_BY_FORM(J2A_TAKE_VALUE_, type, __VA_ARGS__)
#define J2A_TAKE_VALUE_ONE(element, name, n) \
    j2a_c_##element in_##name; \
    j2a_take_##element(&in_##name, bytes);
#define J2A_TAKE_VALUE_FIXED(element, name, n) \
    j2a_c_##element in_##name[n]; \
    uint8_t i; \
    for (i = 0; i < (n); i++) \
        j2a_take_##element(&in_##name[i], bytes + i * j2a_size_##element);
#define J2A_PASS_VALUE(none, item) J2A_IF_FIELD(J2A_PASS_VALUE_OF, item)
#define J2A_PASS_VALUE_OF(type, ...) J2A_BY_FORM(J2A_PASS_VALUE_, type, __VA_ARGS__)
#define J2A_PASS_VALUE_ONE(element, name, n) , j2a_as_##element(&in_##name)
#define J2A_PASS_VALUE_FIXED(element, name, n) , in_##name

/* The bools of a value become 0 or 1. */
#define J2A_TIDY_VALUE(none, item) J2A_IF_FIELD(J2A_TIDY_VALUE_OF, item)
#define J2A_TIDY_VALUE_OF(type, ...) J2A_BY_FORM(J2A_TIDY_VALUE_, type, __VA_ARGS__)
#define J2A_TIDY_VALUE_ONE(element, name, n) J2A_TIDY_VALUE_FIXED(element, name, 1)
#define J2A_TIDY_VALUE_FIXED(element, name, n) \
    j2a_c_##element name; \
    uint8_t i; \
    for (i = 0; i < (n); i++, bytes += j2a_size_##element) { \
        j2a_take_##element(&name, bytes); \
        j2a_put_##element(bytes, j2a_as_##element(&name)); \
    }

/* ------------------------------------------------------------------------- what is kept ------ */

#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)

/* A name that comes twice declares an enumerator twice. */
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) j2a_index_##name,
enum {
#include "j2a_transds_list.h"
    j2a_transducers_listed
};
#undef J2A_TRANSD

#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) \
    J2A_KEPT(name, id, channels, J2A_VALUE_TYPE(type), na, __VA_ARGS__) \
    J2A_KEPT_##KIND(name, prefix, channels, J2A_VALUE_TYPE(type), __VA_ARGS__)
#define J2A_KEPT(name, id, channels, type, na, ...) \
    enum { \
        the_key_prefix_of_##name, \
        the_key_model_of_##name, \
        J2A_EACH(J2A_ONCE, J2A_ONCE, J2A_NOTHING, name, __VA_ARGS__) \
        j2a_bytes_of_##name = 0 J2A_BYTES(~, (type, value)), \
        j2a_bools_of_##name = 0 J2A_BOOLS(~, (type, value)), \
        j2a_depth_of_##name = 0 J2A_SAY(queue, __VA_ARGS__), \
        j2a_entry_of_##name = (j2a_depth_of_##name != 0) + J2A_TIME_BYTES + j2a_bytes_of_##name, \
        j2a_entries_of_##name = j2a_depth_of_##name != 0 ? j2a_depth_of_##name : (channels), \
        j2a_most_of_##name = j2a_depth_of_##name == 0 ? (channels) \
            : (J2A_SAMPLE_ROOM - J2A_LOST_BYTES) / j2a_entry_of_##name < j2a_depth_of_##name \
                ? (J2A_SAMPLE_ROOM - J2A_LOST_BYTES) / j2a_entry_of_##name : j2a_depth_of_##name, \
        j2a_longest_of_##name = (j2a_depth_of_##name != 0) * J2A_LOST_BYTES + \
            j2a_most_of_##name * j2a_entry_of_##name, \
        id_of_##name##_is_0_to_254 = 1 / ((id) >= 0 && (id) <= J2A_TRANSD_MAX_ID), \
        channels_of_##name##_are_1_to_255 = 1 / ((channels) >= 1 && (channels) <= 255), \
        threshold_range_and_na_of_##name##_need_a_number_or_an_enumeration = 1 / \
            (J2A_OF_ORDER(J2A_HAS_RAW, J2A_ORDER(type)) || (sizeof #na == sizeof "none" && \
            (0 J2A_SAY(threshold, __VA_ARGS__)) == 0 && (0 J2A_SAY(range, __VA_ARGS__)) == 0)), \
        queue_of_##name##_is_1_to_255 = 1 / \
            (j2a_depth_of_##name >= (0 J2A_SAY(queued, __VA_ARGS__)) && j2a_depth_of_##name <= 255), \
        decimation_of_##name##_is_1_to_255 = 1 / \
            ((0 J2A_SAY(decimation, __VA_ARGS__)) >= (0 J2A_SAY(decimated, __VA_ARGS__)) && \
            (0 J2A_SAY(decimation, __VA_ARGS__)) <= 255), \
        /* unsigned, so that a negative one is too large */ \
        period_of_##name##_is_0_to_4294967295 = 1 / ((0ULL J2A_SAY(period, __VA_ARGS__)) <= 0xFFFFFFFF), \
        watchdog_of_##name##_is_0_to_65535 = 1 / ((0ULL J2A_SAY(watchdog, __VA_ARGS__)) <= 0xFFFF), \
        enabled_of_##name##_is_0_or_1 = 1 / ((0ULL J2A_SAY(enabled, __VA_ARGS__)) <= 1), \
        topic_of_##name##_is_longer_than_32_bytes = 1 / \
            (sizeof("" J2A_SAY(topictext, __VA_ARGS__)) <= J2A_TRANSD_MAX_TOPIC + 1), \
        a_sample_of_##name##_is_longer_than_a_frame = 1 / (j2a_most_of_##name >= 1 && \
            j2a_longest_of_##name <= (int)J2A_SAMPLE_ROOM && \
            (j2a_depth_of_##name != 0 || j2a_longest_of_##name <= J2A_ROOM)) \
    }; \
    static volatile uint8_t j2a_slots_of_##name[j2a_entries_of_##name * j2a_entry_of_##name]; \
    static char j2a_topic_of_##name[J2A_TRANSD_MAX_TOPIC + 1] = "" J2A_SAY(topictext, __VA_ARGS__); \
    static void j2a_tidy_of_##name(uint8_t *bytes) { \
        J2A_TIDY_VALUE(~, (type, value)) \
    } \
    J2A_RAW(name, type, na, __VA_ARGS__)
#undef J2A_TRIGGER_DRIVER
#define J2A_TRIGGER_DRIVER(prefix) prefix##_trigger();
#define J2A_KEPT_SENSOR(name, prefix, channels, type, ...) \
    static j2a_sensor j2a_sensor_of_##name = {0, false, J2A_LONG_AGO, 0 J2A_SAY(period, __VA_ARGS__), \
        !(0 J2A_SAY(disabled, __VA_ARGS__))}; \
    static j2a_queue j2a_queue_of_##name; \
    static uint8_t j2a_decimation_of_##name[1 + (channels)] = {0 J2A_SAY(decimation, __VA_ARGS__)}; \
    static uint8_t j2a_threshold_of_##name[1 + 2 * j2a_bytes_of_##name]; \
    static uint8_t j2a_last_of_##name[(channels) * (1 + j2a_bytes_of_##name)]; \
    static j2a_due j2a_trigger_of_##name; \
    J2A_INLINE void j2a_start_of_##name(void) { \
        J2A_EACH(J2A_DRIVER_ITEM, J2A_DRIVER_ITEM, J2A_NOTHING, prefix, __VA_ARGS__) \
    } \
    enum { \
        the_key_na_of_##name, \
        j2a_is_newest_of_##name = j2a_depth_of_##name == 0 && \
            (0 J2A_SAY(decimation, __VA_ARGS__)) == 0 && (0 J2A_SAY(threshold, __VA_ARGS__)) == 0 \
    }; \
    void j2a_callback_of_##name J2A_VALUE_OF(type); \
    void j2a_callback_of_##name J2A_VALUE_OF(type) { \
        uint8_t bytes[j2a_bytes_of_##name]; \
        J2A_PUT_VALUE(~, (type, value)) \
        if (!j2a_is_newest_of_##name) \
            j2a_sense(j2a_index_##name, channel, bytes); \
        else if (channel < (channels)) \
            j2a_keep(&j2a_sensor_of_##name, j2a_slots_of_##name + channel * j2a_entry_of_##name, bytes, \
                     j2a_bytes_of_##name); \
    }
#define J2A_KEPT_ACTUATOR(name, prefix, channels, type, ...) \
    enum { the_key_safe_of_##name, queue_of_##name##_which_is_no_sensor = 1 / (j2a_depth_of_##name == 0) }; \
    static j2a_due j2a_waiting_of_##name[channels]; \
    static uint8_t j2a_values_of_##name[(channels) * j2a_bytes_of_##name]; \
    static j2a_watchdog j2a_watchdog_of_##name = {0 J2A_SAY(watchdog, __VA_ARGS__), false}; \
    static void j2a_set_of_##name(uint8_t channel, const uint8_t *bytes) { \
        J2A_TAKE_VALUE(~, (type, value)) \
        prefix##_set J2A_PASSED(channel J2A_PASS_VALUE(~, (type, value))); \
    }
#define J2A_PASSED(...) (__VA_ARGS__)
#include "j2a_transds_list.h"
#undef J2A_TRANSD

/* ------------------------------------------------------------------------- the table ------ */

#define J2A_IF_KEY(which, pointer, ...) (0 J2A_SAY(which, __VA_ARGS__)) != 0 ? (pointer) : 0
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) \
    J2A_ROW_##KIND(name, id, prefix, channels, J2A_OF_ORDER(J2A_ORDER, J2A_VALUE_TYPE(type)), __VA_ARGS__)
#define J2A_ROW_SENSOR(name, id, prefix, channels, order, ...) \
    {id, channels, j2a_bytes_of_##name, j2a_depth_of_##name, &j2a_sensor_of_##name, \
     J2A_IF_KEY(queue, &j2a_queue_of_##name, __VA_ARGS__), j2a_slots_of_##name, \
     J2A_IF_KEY(decimation, j2a_decimation_of_##name, __VA_ARGS__), \
     J2A_IF_KEY(threshold, j2a_threshold_of_##name, __VA_ARGS__), \
     (0 J2A_SAY(threshold, __VA_ARGS__)) != 0 && j2a_depth_of_##name != 0 ? j2a_last_of_##name : 0, \
     J2A_IF_KEY(topic, j2a_topic_of_##name, __VA_ARGS__), \
     J2A_IF_KEY(trigger, &j2a_trigger_of_##name, __VA_ARGS__), 0, 0, 0, \
     J2A_IF_KEY(trigger, j2a_start_of_##name, __VA_ARGS__), 0, J2A_RAW_OR_NOT(order, name), \
     J2A_COMPARE(order), J2A_NEAR(order), \
     (0 J2A_SAY(threshold, __VA_ARGS__)) != 0 && j2a_bools_of_##name != 0 ? j2a_tidy_of_##name : 0},
#define J2A_ROW_ACTUATOR(name, id, prefix, channels, order, ...) \
    {id, channels, j2a_bytes_of_##name, 0, 0, 0, j2a_slots_of_##name, 0, 0, 0, \
     J2A_IF_KEY(topic, j2a_topic_of_##name, __VA_ARGS__), 0, j2a_waiting_of_##name, j2a_values_of_##name, \
     J2A_IF_KEY(guarded, &j2a_watchdog_of_##name, __VA_ARGS__), 0, j2a_set_of_##name, J2A_RAW_OR_NOT(order, name), \
     J2A_COMPARE(order), 0, j2a_bools_of_##name != 0 ? j2a_tidy_of_##name : 0},
const j2a_transducer J2A_FLASH j2a_transducers[] = {
#include "j2a_transds_list.h"
};
#undef J2A_TRANSD
const uint8_t j2a_transducer_count = j2a_transducers_listed;

#if J2A_PORT_SHARES_ROOM
J2A_NOINLINE void transds_process(void) {
    j2a_turn(j2a_rx_room());
}
#else
/* Room for the longest sample SIF. */
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) uint8_t name[j2a_longest_of_##name];
typedef union {
    uint8_t none;
#include "j2a_transds_list.h"
} j2a_longest_sample;
#undef J2A_TRANSD

/* Its sample is not to lie on the stack while a request is executed. */
J2A_NOINLINE void transds_process(void) {
    j2a_longest_sample payload;
    j2a_turn(&payload.none);
}
#endif

/* What the port must keep: two records for each, with the length and the bytes of each setting. */
#if J2A_WITH_SAVE
#define J2A_HAS_KEY(which, ...) ((0 J2A_SAY(which, __VA_ARGS__)) != 0)
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) \
    + 2 * (J2A_SAVED_HEADER + J2A_SAVED_##KIND + 2 * J2A_HAS_KEY(decimation, __VA_ARGS__) + \
           (1 + j2a_bytes_of_##name) * J2A_HAS_KEY(threshold, __VA_ARGS__) + \
           (1 + J2A_TRANSD_MAX_TOPIC) * J2A_HAS_KEY(topic, __VA_ARGS__) + 3 * J2A_HAS_KEY(guarded, __VA_ARGS__))
#define J2A_SAVED_SENSOR (2 + 5)
#define J2A_SAVED_ACTUATOR 0
enum {
    j2a_saved_bytes = 0
#include "j2a_transds_list.h"
    ,
    the_settings_fit_into_what_the_port_keeps = 1 / (j2a_saved_bytes <= J2A_PORT_KEPT_BYTES)
};
#undef J2A_TRANSD
#endif

void transds_init(void) {
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) \
    J2A_INIT_##KIND(name, prefix, J2A_OF_ORDER(J2A_ORDER, J2A_VALUE_TYPE(type)), __VA_ARGS__)
#define J2A_INIT_ACTUATOR(name, prefix, order, ...)
#define J2A_INIT_SENSOR(name, prefix, order, ...) \
    J2A_OF_ORDER2(J2A_INIT_THRESHOLD, order, name, (0 J2A_SAY(threshold, __VA_ARGS__)) != 0) \
    prefix##_set_cb(j2a_callback_of_##name);
#define J2A_OF_ORDER2(macro, order, name, is_there) macro(order, name, is_there)
#define J2A_INIT_THRESHOLD(order, name, is_there) \
    J2A_INNER_SECOND(J2A_INIT_THRESHOLD_##order, J2A_SET_THRESHOLD)(name, is_there)
#define J2A_INIT_THRESHOLD_none ~, J2A_NO_THRESHOLD
#define J2A_NO_THRESHOLD(name, is_there) (void)j2a_threshold_of_##name;
#define J2A_SET_THRESHOLD(name, is_there) \
    if (is_there) \
        (void)j2a_raw_of_##name(J2A_RAW_THRESHOLD, j2a_threshold_of_##name + 1);
#include "j2a_transds_list.h"
#undef J2A_TRANSD
#if J2A_WITH_SAVE
    j2a_save_start();
#endif
/* An id that comes twice is a case that comes twice. */
#define J2A_TRANSD(KIND, name, id, prefix, model, channels, type, na, ...) case id:
    switch (j2a_transducer_count) {
#include "j2a_transds_list.h"
    default:
        break;
    }
#undef J2A_TRANSD
}
#undef J2A_ENUM
#undef J2A_STRUCT

/* ------------------------------------------------------------------------- descriptors ------ */

#define J2A_ATTRIBUTE_ITEM(none, item) J2A_PASTE6(J2A_ATTRIBUTE_ITEM_, J2A_IN_PARENTHESES(item))(item)
#define J2A_ATTRIBUTE_ITEM_0(item)
#define J2A_ATTRIBUTE_ITEM_1(item) J2A_APPLY(J2A_ATTRIBUTE, J2A_STRIP item)
#define J2A_ATTRIBUTE(...) J2A_PASTE3(J2A_ATTRIBUTE_, J2A_ONE_OR_MORE(__VA_ARGS__))(__VA_ARGS__)
#define J2A_ATTRIBUTE_ONE(key) " " #key "\n"
#define J2A_ATTRIBUTE_MORE(key, ...) J2A_INNER_SECOND(J2A_ATTRIBUTE_##key, J2A_ATTRIBUTE_TEXT)(key, __VA_ARGS__)
#define J2A_ATTRIBUTE_TEXT(key, ...) " " #key " " #__VA_ARGS__ "\n"
#define J2A_ATTRIBUTE_range ~, J2A_RANGE_TEXT
#define J2A_RANGE_TEXT(key, low, high) " range " #low ", " #high "\n"
#define J2A_ATTRIBUTE_unit ~, J2A_NO_TEXT
#define J2A_NO_TEXT(key, ...)
#define J2A_DOC_ITEM(none, item) J2A_PASTE6(J2A_DOC_ITEM_, J2A_IN_PARENTHESES(item))(item)
#define J2A_DOC_ITEM_0(text) " # " text
#define J2A_DOC_ITEM_1(item)
#define J2A_KIND_SENSOR "sensor "
#define J2A_KIND_ACTUATOR "actuator "
#define J2A_NA_SENSOR " na "
#define J2A_NA_ACTUATOR " safe "
#define J2A_DESCRIPTOR(KIND, name, id, prefix, model, channels, type, na, ...) \
    J2A_KIND_##KIND #name " " #id " " #channels " " J2A_SPELL(J2A_VALUE_TYPE(type)) J2A_SAY(unit, __VA_ARGS__) \
    J2A_EACH(J2A_DOC_ITEM, J2A_DOC_ITEM, J2A_NOTHING, ~, __VA_ARGS__) "\n prefix " #prefix "\n model " #model "\n" \
    J2A_NA_##KIND #na "\n" J2A_EACH(J2A_ATTRIBUTE_ITEM, J2A_ATTRIBUTE_ITEM, J2A_NOTHING, ~, __VA_ARGS__)

/* The definitions come first, wherever they stand. */
const char J2A_FLASH j2a_descriptors[] = ""
#define J2A_TRANSD(KIND, ...)
#define J2A_ENUM J2A_ENUM_TEXT
#define J2A_STRUCT J2A_STRUCT_TEXT
#include "j2a_transds_list.h"
    "\n"
#undef J2A_TRANSD
#undef J2A_ENUM
#undef J2A_STRUCT
#define J2A_TRANSD J2A_DESCRIPTOR
#define J2A_ENUM(name, integer, ...)
#define J2A_STRUCT(name, ...)
#include "j2a_transds_list.h"
    ;

#endif
