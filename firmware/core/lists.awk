# Checks a functions.def or properties.def, so that a slip in it is one message and not a page of the
# compiler's. In: the file. Out: nothing, or the first thing that is wrong. Comments, directives and macros
# that the file defines itself are C's; with an #include, what it uses of that is, too.
BEGIN { is_properties = ARGV[1] ~ /properties\.def$/ }

{
    line = $0
    if (directive || line ~ /^[ \t]*#/) {
        if (!directive && line ~ /^[ \t]*#[ \t]*include/)
            includes = 1
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
    c = substr(text, 1, 1)
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
function read_arguments(    count, depth, begin, c) {
    count = 1
    depth = 1
    begin = number
    split("", argument)
    for (;;) {
        skip_blanks()
        if (text == "") {
            number = begin
            wrong("a \")\" is missing")
        }
        if (text ~ /^"/) {
            if (!match(text, /^"([^"\\\n]|\\.)*"/)) {
                wrong("a string has no end")
            }
            argument[count] = argument[count] substr(text, 1, RLENGTH)
            text = substr(text, RLENGTH + 1)
            continue
        }
        c = next_character()
        if (c == "(")
            depth++
        if (c == ")" && --depth == 0)
            return count
        if (c == "," && depth == 1)
            count++
        else
            argument[count] = argument[count] c
    }
}

function check_function(macro, count) {
    if (count != 2)
        wrong(macro " takes a name and a function, such as " macro "(add, app_add): a name has no comma")
    if (argument[1] ~ /"/)
        wrong("a name has no quotes: " macro "(add, app_add)")
    if (argument[1] !~ /^[A-Za-z0-9_]+$/)
        wrong("the name \"" argument[1] "\" has other characters than letters, digits and _")
    if (argument[2] !~ /^[A-Za-z_][A-Za-z0-9_]*$/)
        wrong("\"" argument[2] "\" is no C function: " macro "(add, app_add)")
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
        known = is_properties ? macro == "J2A_PROPERTY" : macro == "J2A_CALL" || macro == "J2A_MANY"
        if (!known && !includes && !(macro in own))
            wrong(macro " is not " (is_properties ? "J2A_PROPERTY" : "J2A_CALL or J2A_MANY"))
        skip_blanks()
        if (text !~ /^\(/) {
            if (known)
                wrong("a \"(\" is missing behind " macro)
            continue
        }
        next_character()
        count = read_arguments()
        if (known && is_properties && count != 2)
            wrong("J2A_PROPERTY takes a key and a value, each in quotes")
        if (known && !is_properties)
            check_function(macro, count)
    }
}
