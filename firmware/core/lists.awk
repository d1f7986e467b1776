# Checks a functions.def or properties.def, so that a slip in it is one message and not a page of the
# compiler's. In: the file. Out: nothing, or the first thing that is wrong. Comments, directives and macros
# that the file defines itself are C's; with an #include, what it uses of that is, too.
BEGIN {
    is_properties = ARGV[1] ~ /properties\.def$/
    count = split("bool u8 u16 u32 u64 i8 i16 i32 i64 f32 f64 text bytes", elements, " ")
    for (i = 1; i <= count; i++)
        is_element[elements[i]] = 1
    is_open["text"] = is_open["bytes"] = 1
    split("1 1 2 4 8 1 2 4 8 4 8 1 1", sizes, " ")
    for (i = 1; i <= count; i++)
        size_of[elements[i]] = sizes[i]
    count = split("J2A_FUNCTION J2A_BUFFER J2A_SIF J2A_STRUCT J2A_ENUM J2A_CALL J2A_MANY", macros, " ")
    for (i = 1; i <= count; i++)
        is_macro[macros[i]] = 1
    count = split("int:i32 int8_t:i8 int16_t:i16 int32_t:i32 int64_t:i64 uint8_t:u8 uint16_t:u16 uint32_t:u32 " \
        "uint64_t:u64 byte:u8 short:i16 long:i32 unsigned:u32 float:f32 double:f64 string:text str:text char:text " \
        "boolean:bool _Bool:bool", words, " ")
    for (i = 1; i <= count; i++) {
        split(words[i], pair, ":")
        alias[pair[1]] = pair[2]
    }
    # Of C and C++: none of them can name a parameter or a type.
    count = split("auto break case char class const continue default delete do double else enum extern float for " \
        "goto if inline int long new operator private public register restrict return short signed sizeof static " \
        "struct switch template this typedef union unsigned using virtual void volatile while true false", words, " ")
    for (i = 1; i <= count; i++)
        is_keyword[words[i]] = 1
}

{
    line = $0
    if (directive || line ~ /^[ \t]*#/) {
        if (!directive && line ~ /^[ \t]*#[ \t]*include/)
            includes = 1
        if (line ~ /^[ \t]*#[ \t]*if/)
            directives = 1 # the same name may stand in both branches
        if (!directive && match(line, /define[ \t]+[A-Za-z_0-9]+/)) {
            name = substr(line, RSTART, RLENGTH)
            sub(/define[ \t]+/, "", name)
            own[name] = 1
        }
        directive = line ~ /\\$/
        line = ""
    }
    text = text line "\n"
}

function wrong(what) {
    file = ARGV[1]
    sub(/.*\//, "", file)
    print file ":" number ": " what
    exit 1
}

# Drops the first character, and counts lines.
function next_character(    c) {
    last = c = substr(text, 1, 1)
    text = substr(text, 2)
    if (c == "\n")
        number++
    return c
}

function skip_blanks(    begin) {
    for (;;) {
        if (text ~ /^[ \t\r\n]/) {
            next_character()
        } else if (text ~ /^\/\//) {
            while (text != "" && text !~ /^\n/)
                next_character()
        } else if (text ~ /^\/\*/) {
            begin = number
            while (text != "" && text !~ /^\*\//)
                next_character()
            if (text == "") {
                number = begin
                wrong("this comment has no end")
            }
            next_character()
            next_character()
        } else {
            return
        }
    }
}

# Reads the arguments behind a "(" into `argument`; returns how many.
function read_arguments(    count, depth, begin, c, left) {
    count = 1
    depth = 1
    begin = number
    split("", argument)
    for (;;) {
        left = length(text)
        skip_blanks()
        if (text == "") {
            number = begin
            wrong("a \")\" is missing")
        }
        if (length(text) < left && !is_properties && argument[count] ~ /[A-Za-z0-9_]$/ && text ~ /^[A-Za-z0-9_]/)
            wrong("a comma is missing behind " argument[count])
        if (last !~ /[A-Za-z0-9_]/ && match(text, /^J2A_[A-Z]+/) && (substr(text, 1, RLENGTH) in is_macro)) {
            number = begin
            wrong("a \")\" is missing: the next entry begins within this one")
        }
        if (text ~ /^"/) {
            if (!match(text, /^"([^"\\\n]|\\.)*"/)) {
                wrong("a string has no end")
            }
            if (argument[count] ~ /[^",(]$/)
                wrong("a comma is missing before " substr(text, 1, RLENGTH))
            argument[count] = argument[count] substr(text, 1, RLENGTH)
            text = substr(text, RLENGTH + 1)
            continue
        }
        c = next_character()
        if (c == "(") {
            if (argument[count] ~ /[")]$/ && !is_properties)
                wrong("a comma is missing behind " argument[count])
            depth++
        }
        if (c == ")" && --depth == 0)
            return count
        if (c == "," && depth == 1)
            count++
        else
            argument[count] = argument[count] c
    }
}

function check_raw(macro, count) {
    if (count != 2)
        wrong(macro " takes a name and a function, such as " macro "(add, app_add): a name has no comma")
    if (argument[1] ~ /"/)
        wrong("a name has no quotes: " macro "(add, app_add)")
    if (argument[1] !~ /^[A-Za-z0-9_]+$/)
        wrong("the name \"" argument[1] "\" has other characters than letters, digits and _")
    if (argument[2] !~ /^[A-Za-z_][A-Za-z0-9_]*$/)
        wrong("\"" argument[2] "\" is no C function: " macro "(add, app_add)")
}

function least(a, b) { return a < b ? a : b }

# Letters to put in, leave out or change to make one of the other (Levenshtein).
function distance(a, b,    i, j, row, before, kept) {
    for (j = 0; j <= length(b); j++)
        row[j] = j
    for (i = 1; i <= length(a); i++) {
        before = row[0]
        row[0] = i
        for (j = 1; j <= length(b); j++) {
            kept = row[j]
            row[j] = least(least(row[j], row[j - 1]) + 1, before + (substr(a, i, 1) != substr(b, j, 1)))
            before = kept
        }
    }
    return row[length(b)]
}

# "; did you mean X?" for the nearest of the names, if one is near.
function suggestion(name, names,    best, far, each, nearest) {
    if (name in alias)
        return "; did you mean " alias[name] "?"
    best = length(name) < 4 ? 2 : 3
    for (each in names) {
        far = distance(tolower(name), tolower(each))
        if (far < best || (far == best && nearest != "" && each < nearest)) {
            best = far
            nearest = each
        }
    }
    return nearest == "" ? "" : "; did you mean " nearest "?"
}

# A name on the wire and in C. what: such as "function".
function check_name(name, what) {
    if (name ~ /^"/)
        wrong("the name of a " what " has no quotes: " name)
    if (name == "")
        wrong("the name of a " what " is missing")
    if (name !~ /^[A-Za-z_][A-Za-z0-9_]*$/)
        wrong("\"" name "\" is no name of a " what ": a name has letters, digits and _, and no digit first")
    if (length(name) > 32)
        wrong("the name " name " is longer than 32 characters")
    if (name in is_keyword)
        wrong("the name of a " what " cannot be " name ", a word of C")
}

function check_new(names, name, what) {
    if (name in names && !directives)
        wrong("the name " name " stands here twice: another " what " of line " names[name] " has it")
    names[name] = number
}

function check_text(text) {
    if (text !~ /^"/)
        wrong("the text at the end is missing: " macro " ends with \"what it is for\"")
    if (text == "\"\"")
        wrong("the text at the end is empty: say in a few words what it is for")
    if (text ~ /\\[abefnrtv0-7x]/ || text ~ /[\001-\037\177]/)
        wrong("the text has a control character: it is one line of plain text")
}

# Splits the inside of "(a, b, c)" at its commas into part; returns how many.
function split_item(item, part,    inside, depth, count, i, c) {
    split("", part)
    inside = substr(item, 2, length(item) - 2)
    count = 1
    for (i = 1; i <= length(inside); i++) {
        c = substr(inside, i, 1)
        if (c == "(")
            depth++
        if (c == ")")
            depth--
        if (c == "," && depth == 0)
            count++
        else
            part[count] = part[count] c
    }
    return count
}

function is_number(text) { return text ~ /^[1-9][0-9]*$/ }

# A number, or a macro of C that may stand for one.
function is_length(text) { return is_number(text) || text ~ /^[A-Z_][A-Z0-9_]*$/ }

function check_unit(unit) {
    if (unit ~ /"/)
        wrong("a unit has no quotes: (u16, voltage, mV)")
    if (unit !~ "^[][A-Za-z0-9%*./^_+{}-]+$" || length(unit) > 32)
        wrong("\"" unit "\" is no unit: give a symbol of UCUM such as mV, Cel, deg or m/s2")
}

function is_type(name) { return name in is_element || name in types }

# Checks a type; sets open, and adds its bytes to size.
function check_type(type,    part, count) {
    open = 0
    if (type !~ /^array\(.*\)$/) {
        if (type ~ /^[A-Za-z_]+\(/)
            wrong("\"" type "\" is no type: an array is array(i16, 3)")
        check_type_name(type)
        open = type in is_open
        size += open ? 0 : size_of[type]
        return
    }
    count = split_item(substr(type, 6), part)
    if (count > 2)
        wrong("array takes a type and a length, such as array(i16, 3), and not " count " items")
    if (part[1] ~ /^array/)
        wrong("an array of arrays is no type: put the inner one into a J2A_STRUCT")
    check_type_name(part[1])
    if (count == 2 && part[2] == "0")
        wrong("the length of an array is 0: leave it out for an array of any number")
    if (count == 2 && !is_length(part[2]))
        wrong("\"" part[2] "\" is no length of an array: give a whole number from 1 on")
    if (count == 2 && is_number(part[2]) && part[2] + 0 > 65535)
        wrong("the length of an array is at most 65535, not " part[2])
    if (count == 1 && part[1] in is_open)
        wrong(part[1] " is of any length by itself: write " part[1] ", or array(" part[1] ", 16) for a limit")
    open = count == 1 || part[1] in is_open
    size += open || !is_number(part[2]) ? 0 : part[2] * size_of[part[1]]
}

# Checks the name of a type; sets depth, of nested structures.
function check_type_name(name) {
    if (is_type(name)) {
        if (depth_of[name] > depth)
            depth = depth_of[name]
        return
    }
    if (name == "")
        wrong("a type is missing")
    if (name == "void")
        wrong("void is no type of a field: leave the field out")
    if (name ~ /\[/)
        wrong("an array is array(i16, 3), or array(i16) for one of any number, and not " name)
    if (name !~ /^[A-Za-z_][A-Za-z0-9_]*$/)
        wrong("\"" name "\" is no type")
    if (!includes)
        wrong("there is no type " name suggestion(name, size_of))
}

# Checks (type, name) or (type, name, unit). names: of the fields before.
function check_field(item, names, what,    part, count) {
    if (open)
        wrong("nothing may follow a " what " of any length: " item " comes behind one")
    count = split_item(item, part)
    if (count < 2)
        wrong(item " is no " what ": give (type, name) or (type, name, unit), such as (u16, voltage, mV)")
    if (count > 3)
        wrong(item " has " count " parts: give (type, name) or (type, name, unit)")
    if (part[1] !~ /^array/ && !is_type(part[1]) && is_type(part[2]))
        wrong("in " item " the type comes first: (" part[2] ", " part[1] ")")
    check_name(part[2], what)
    if (part[2] in names)
        wrong("the name " part[2] " stands twice in this " macro)
    names[part[2]] = 1
    check_type(part[1])
    if (count == 3)
        check_unit(part[3])
    if (size > 255)
        wrong("this is longer than a payload of 255 bytes, from " item " on")
}

# Fields from argument `first` to `last`; returns how many.
function check_fields(first, last, what,    i, names) {
    split("", names)
    size = open = depth = 0
    for (i = first; i <= last; i++) {
        if (argument[i] !~ /^\(/)
            wrong(argument[i] == "" ? "a comma is too many" : "\"" argument[i] "\" is no " what ": give (type, name)")
        check_field(argument[i], names, what)
    }
    return last - first + 1
}

function check_result(result,    part, count, i, names) {
    size = open = 0
    if (result == "")
        wrong("the result is missing: give a type, or void")
    if (result == "void")
        return
    if (result !~ /^\(/) {
        check_type(result)
    } else {
        count = split_item(result, part)
        if (part[1] !~ /^\(/) {
            if (count == 2 && is_type(part[2]))
                wrong("several results are ((f32, x), (f32, y)), each with a name")
            if (count > 2)
                wrong(result " is no result: give a type, (type, unit), or ((type, name), (type, name))")
            check_type(part[1])
            if (count == 2)
                check_unit(part[2])
        } else {
            if (count > 8)
                wrong("a function has at most 8 results, not " count)
            split("", names)
            for (i = 1; i <= count; i++)
                check_field(part[i], names, "result")
        }
    }
    if (size > 255)
        wrong("the result is longer than a payload of 255 bytes")
}

function check_flag(flag,    time) {
    if (flag == "idempotent")
        return
    if (flag ~ /^slow\(.*\)$/) {
        time = substr(flag, 6, length(flag) - 6)
        if (!is_number(time) || time + 0 > 65535)
            wrong("slow takes 1 to 65535 milliseconds, such as slow(500)")
        return
    }
    if (flag == "slow")
        wrong("slow takes a number of milliseconds, such as slow(500)")
    if (flag == "")
        wrong("a comma is too many")
    if (flag ~ /^"/)
        wrong("the text " flag " is not at the end")
    wrong("\"" flag "\" is neither a parameter such as (i32, a) nor idempotent nor slow(500)")
}

function check_function(count,    i, parameters) {
    check_name(argument[1], "function")
    check_new(functions, argument[1], "function")
    if (count < 2)
        wrong("J2A_FUNCTION takes a name, a result, parameters and a text, such as " \
            "J2A_FUNCTION(add, i32, (i32, a), (i32, b), \"Adds two numbers.\")")
    if (argument[2] ~ /^"/)
        wrong("the result is missing: give a type, or void")
    check_text(argument[count])
    if (count < 3)
        wrong("the result is missing: give a type, or void")
    check_result(argument[2])
    for (i = 3; i < count && argument[i] ~ /^\(/; i++)
        parameters++
    if (parameters > 8)
        wrong("a function has at most 8 parameters, not " parameters ": put some into a J2A_STRUCT")
    check_fields(3, 2 + parameters, "parameter")
    for (; i < count; i++) {
        if (argument[i] ~ /^\(/)
            wrong("the parameter " argument[i] " comes before flags")
        check_flag(argument[i])
    }
}

function check_buffer(count,    part, type) {
    check_name(argument[1], "buffer")
    check_new(functions, argument[1], "function")
    if (count != 4)
        wrong("J2A_BUFFER takes a name, a type, a length and a text, such as " \
            "J2A_BUFFER(config, bytes, 2048, \"The configuration.\")")
    check_text(argument[4])
    type = argument[2]
    if (type ~ /^\(/) {
        if (split_item(type, part) != 2)
            wrong(type " is no type: give a type or (type, unit)")
        type = part[1]
        check_unit(part[2])
    }
    if (type ~ /^array/)
        wrong("the length of a buffer is its own item: J2A_BUFFER(config, bytes, 2048, \"...\")")
    check_type(type)
    if (type == "bool" || type in is_structure)
        wrong("a buffer holds bytes, text or numbers, not " type)
    if (!is_length(argument[3]) || (is_number(argument[3]) && argument[3] + 0 > 65535))
        wrong("the length of a buffer is a number from 1 to 65535, not \"" argument[3] "\"")
}

function check_sif(count,    others) {
    check_name(argument[1], "SIF")
    check_new(sifs, argument[1], "SIF")
    if (count < 3)
        wrong("J2A_SIF takes a name, an opcode, fields and a text, such as " \
            "J2A_SIF(counter, 32, (u32, count), \"Counts.\")")
    check_text(argument[count])
    if (argument[2] !~ /^(0|[1-9][0-9]*)$/ || argument[2] + 0 > 255)
        wrong("the opcode of a SIF is a number from 0 to 255, not \"" argument[2] "\"")
    if (argument[2] in sif_opcodes && !directives)
        wrong("the opcode " argument[2] " stands here twice: the SIF of line " sif_opcodes[argument[2]] " has it")
    sif_opcodes[argument[2]] = number
    check_fields(3, count - 1, "field")
}

function check_type_declared(what) {
    check_name(argument[1], what)
    if (argument[1] in is_element || argument[1] == "array")
        wrong("the name " argument[1] " is that of a type that exists")
    check_new(types, argument[1], "type")
}

function check_struct(count) {
    if (count < 2)
        wrong("J2A_STRUCT takes a name and fields, such as J2A_STRUCT(point, (f32, x), (f32, y))")
    if (argument[count] ~ /^"/)
        wrong("J2A_STRUCT has no text")
    if (count > 33)
        wrong("a structure has at most 32 fields, not " (count - 1))
    check_fields(2, count, "field")
    if (open)
        wrong("a structure cannot hold a field of any length: " argument[count])
    check_type_declared("structure")
    if (depth > 7)
        wrong("structures are nested more than 8 deep, from " argument[1] " on")
    is_structure[argument[1]] = 1
    depth_of[argument[1]] = depth + 1
    size_of[argument[1]] = size
}

function check_enum(count,    i, bits, part, names, numbers, most) {
    if (count < 3)
        wrong("J2A_ENUM takes a name, an integer type and values, such as J2A_ENUM(mode, u8, (off, 0), (on, 1))")
    check_type_declared("enumeration")
    if (argument[2] !~ /^[ui](8|16|32|64)$/)
        wrong("an enumeration holds an integer such as u8, not " argument[2])
    if (argument[count] ~ /^"/)
        wrong("J2A_ENUM has no text")
    if (count > 34)
        wrong("an enumeration has at most 32 values, not " (count - 2))
    bits = least(substr(argument[2], 2) - (argument[2] ~ /^i/), 31) # an enumeration of C holds an int
    for (most = 1; bits > 0; bits--)
        most *= 2
    most--
    split("", names)
    split("", numbers)
    for (i = 3; i <= count; i++) {
        if (argument[i] !~ /^\(/ || split_item(argument[i], part) != 2)
            wrong("\"" argument[i] "\" is no value: give (name, number), such as (off, 0)")
        check_name(part[1], "value")
        if (part[2] !~ /^(0|-?[1-9][0-9]*)$/)
            wrong("\"" part[2] "\" is no number of a value: give a whole number such as 2, in decimal")
        if (part[2] + 0 > most || part[2] + 0 < (argument[2] ~ /^u/ ? 0 : -most - 1))
            wrong("the number " part[2] " of " part[1] " does not fit into " argument[2] " and an int of C")
        if (part[1] in names)
            wrong("the name " part[1] " stands twice in this " macro)
        if (part[2] in numbers)
            wrong("the number " part[2] " stands twice in this " macro)
        names[part[1]] = numbers[part[2]] = 1
    }
    size_of[argument[1]] = size_of[argument[2]]
}

function check(macro, count) {
    if (macro == "J2A_CALL" || macro == "J2A_MANY") {
        check_raw(macro, count)
        check_new(functions, argument[1], "function")
    } else if (macro == "J2A_FUNCTION") {
        check_function(count)
    } else if (macro == "J2A_BUFFER") {
        check_buffer(count)
    } else if (macro == "J2A_SIF") {
        check_sif(count)
    } else if (macro == "J2A_STRUCT") {
        check_struct(count)
    } else {
        check_enum(count)
    }
}

END {
    if (number)
        exit 1
    number = 1
    for (skip_blanks(); text != ""; skip_blanks()) {
        if (!match(text, /^[A-Za-z_][A-Za-z_0-9]*/))
            wrong("\"" substr(text, 1, 1) "\" is not expected here: entries follow each other without a sign")
        macro = substr(text, 1, RLENGTH)
        text = substr(text, RLENGTH + 1)
        known = is_properties ? macro == "J2A_PROPERTY" : macro in is_macro
        if (!known && !includes && !(macro in own))
            wrong(macro " is not " (is_properties ? "J2A_PROPERTY" : \
                "J2A_CALL or J2A_MANY, nor another entry" suggestion(macro, is_macro)))
        skip_blanks()
        if (text !~ /^\(/) {
            if (known)
                wrong("a \"(\" is missing behind " macro)
            continue
        }
        next_character()
        first_line = number
        count = read_arguments()
        last_line = number
        number = first_line
        if (known && is_properties && count != 2)
            wrong("J2A_PROPERTY takes a key and a value, each in quotes")
        if (known && is_properties && argument[1] ~ /^"j2a\.(room|interface|selftest)"$/)
            wrong(argument[1] " is there already: the core has this property where it belongs")
        if (known && !is_properties)
            check(macro, count)
        number = last_line
    }
}
