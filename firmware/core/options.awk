# Finds options of the core, the port or the app that do not exist.
# In: `asked`, names with blanks between them; files, in whose conditions the options stand. Out: the first
# name that stands in none, and the nearest one that does.
/^[ \t]*#[ \t]*(if|ifdef|ifndef|elif)/ || /^[ \t]*[|&]/ || continued {
    continued = /\\$/
    line = $0
    while (match(line, /J2A_[A-Z0-9_]+/)) {
        known[substr(line, RSTART, RLENGTH)] = 1
        line = substr(line, RSTART + RLENGTH)
    }
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
            row[j] = least(least(row[j], row[j - 1]) + 1,
                           before + (substr(a, i, 1) != substr(b, j, 1)))
            before = kept
        }
    }
    return row[length(b)]
}

END {
    count = split(asked, names, " ")
    for (i = 1; i <= count; i++) {
        if (names[i] in known)
            continue
        best = 1000
        for (name in known) {
            far = distance(toupper(names[i]), name)
            if (far < best || (far == best && name < nearest)) {
                best = far
                nearest = name
            }
        }
        print "there is no option " names[i] "; did you mean " nearest "?"
        exit
    }
}
