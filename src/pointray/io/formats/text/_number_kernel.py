"""Compiled kernel for parsing numbers in text, see `_numbers`.

The digits of a number are read as an integer w and a power of ten q. w * 10^q is rounded to the nearest float64 with
integer arithmetic only (Lemire, Number parsing at a gigabyte per second, 2021), because kernels may replace a division
by a multiplication, which would change the last bits. Cases that this does not cover (subnormal numbers, more than 19
significant digits, unusual words) are left to Python's float.
"""

from __future__ import annotations

from ....engine.jit import Array, borrow, i64, inline, kernel, next_tile, u64

OTHER, DIGIT, DOT, BLANK, DELIMITER, END = range(6)  # classes of bytes; from BLANK on they separate
SKIP, FLOAT, SCAN, INT = range(4)  # modes of a column: ignored, float64, limits of integers, int64
WHOLE, REAL, NAN, INFINITE, BAD = range(5)  # classes of tokens
FINE, COLUMNS, SINGLE, NOT_WHOLE = range(4)  # why parsing of a piece ends: at its end, wrong columns, one, no integer
ROWS, WHY, WHERE, ODD, STATES = range(5)  # columns of the table of pieces; ODD: number of tokens left to Python
IS_WHOLE, LEAST, MOST, STATS = range(4)  # statistics of a column
MARK = 0x7FFC << 48  # NaN whose low bits are the offset of a token left to Python
NOT_A_NUMBER, INFINITY, SIGN_BIT = 0x7FF8 << 48, 0x7FF0 << 48, -(1 << 63)
LOWEST, HIGHEST = -342, 308  # range of the powers of ten in the table
DIGITS = 19  # number of digits that always fit into 64 bits

Number = tuple[int, int, int, int, bool, bool]


@inline
def _byte(data: Array, at: int) -> int:
    """Return the byte at an offset. An unsigned index avoids the check for negative indices."""
    return i64(data[u64(at)])


@inline
def _kind(table: Array, data: Array, at: int) -> int:
    return i64(table[data[u64(at)]])


@inline
def _product(a: int, b: int) -> tuple[int, int]:
    """Return the upper and the lower 64 bits of the product of two unsigned 64-bit integers."""
    mask, half = u64(0xFFFFFFFF), u64(32)
    a0, a1, b0, b1 = a & mask, a >> half, b & mask, b >> half
    low, cross, other = a0 * b0, a0 * b1, a1 * b0
    middle = (low >> half) + (cross & mask) + (other & mask)
    high = a1 * b1 + (cross >> half) + (other >> half) + (middle >> half)
    return high, (middle << half) | (low & mask)


@inline
def _leading_zeros(w: int) -> int:
    count, width = 0, 32
    while width > 0:
        if w >> u64(64 - width) == u64(0):
            count += width
            w = w << u64(width)
        width >>= 1
    return count


@inline
def _float_bits(w: int, q: int, powers: Array) -> int:
    """Return the bits of the float64 nearest to w * 10^q, w > 0; -1 if it is subnormal.

    powers : table of the leading 128 bits of the powers of ten
    """
    if q < LOWEST or q > HIGHEST:
        return 0 if q < LOWEST else INFINITY
    zeros = _leading_zeros(w)
    w = w << u64(zeros)
    at = 2 * (q - LOWEST)
    high, low = _product(w, powers[at])
    if high & u64(0x1FF) == u64(0x1FF):
        more, _ = _product(w, powers[at + 1])
        low += more
        if more > low:
            high += u64(1)
    upper = high >> u64(63)
    shift = upper + u64(9)
    mantissa = high >> shift
    power = ((217706 * q) >> 16) + 63 + 1023 - zeros + i64(upper)
    if low <= u64(1) and -4 <= q <= 23 and mantissa & u64(3) == u64(1) and mantissa << shift == high:
        mantissa -= u64(1)  # halfway between two numbers: round to even
    mantissa = (mantissa + (mantissa & u64(1))) >> u64(1)
    if mantissa >> u64(53) != u64(0):
        mantissa = mantissa >> u64(1)
        power += 1
    if power <= 0 or power >= 2047:
        return -1 if power <= 0 else INFINITY
    return i64(mantissa & u64((1 << 52) - 1)) | (power << 52)


@inline
def _bits(number: Number, powers: Array) -> int:
    """Return the bits of the float64 that a parsed word represents; -1 if Python's float must parse it.

    number : (end, class, w, q, negative, digits lost) of the word, whose value is w * 10^q
    powers : table of the leading 128 bits of the powers of ten
    """
    _, form, w, q, negative, cut = number
    bits = NOT_A_NUMBER if form == NAN else INFINITY if form == INFINITE else 0
    if form == WHOLE or form == REAL:  # noqa: SIM109  # `in` would create a tuple
        if w != u64(0):
            bits = _float_bits(w, q, powers)
        if cut and bits != _float_bits(w + u64(1), q, powers):
            bits = -1
    if form == BAD or bits == -1:
        return -1
    return bits | SIGN_BIT if negative else bits


@inline
def _digits(data: Array, at: int, w: int, kept: int, lost: int) -> tuple[int, int, int, int, bool]:
    """Read decimal digits from an offset on; append them to the integer w while it has fewer than 19, drop the others.

    Return the offset after the digits, the new w, how many digits w has, how many digits were dropped, and whether a
    dropped digit is not 0.

    data : (bytes,) uint8; at : offset of the first digit
    kept, lost : numbers of digits in w and of digits dropped before
    """
    cut = False
    d = _byte(data, at) - 48
    while 0 <= d <= 9:
        if kept < DIGITS:
            w = w * u64(10) + u64(d)
            kept += 1 if w != u64(0) else 0
        else:
            lost += 1
            cut = cut or d != 0
        at += 1
        d = _byte(data, at) - 48
    return at, w, kept, lost, cut


@inline
def _few_digits(data: Array, at: int, w: int) -> tuple[int, int]:
    """Read decimal digits from an offset on and append them to the integer w.

    Return the offset after the digits and the new w. With more than 19 digits w overflows; the caller then reads all
    digits again.
    """
    d = _byte(data, at) - 48
    while 0 <= d <= 9:
        w = w * u64(10) + u64(d)
        at += 1
        d = _byte(data, at) - 48
    return at, w


@inline
def _word(data: Array, at: int) -> int:
    """Return the class of a word of three letters, in any case: `NAN` for nan, `INFINITE` for inf, else `BAD`."""
    a, b, c = _byte(data, at) | 32, 0, 0
    if a == 110 or a == 105:
        b = _byte(data, at + 1) | 32
    if b == 97 or b == 110:
        c = _byte(data, at + 2) | 32
    if a == 110 and b == 97 and c == 110:
        return NAN
    return INFINITE if a == 105 and b == 110 and c == 102 else BAD


@inline
def _exponent(data: Array, at: int) -> tuple[int, int]:
    """Read a decimal exponent after its e; return the offset after the exponent (-1 without digits) and its value."""
    sign = _byte(data, at)
    at += 1 if sign == 45 or sign == 43 else 0
    begin, value = at, 0
    d = _byte(data, at) - 48
    while 0 <= d <= 9:
        value = min(10 * value + d, 1 << 30)  # avoids overflow; a line has far fewer digits
        at += 1
        d = _byte(data, at) - 48
    return at if at > begin else -1, -value if sign == 45 else value


@inline
def _token(data: Array, at: int, table: Array) -> Number:
    """Read the word at an offset as a number w * 10^q.

    Return the offset after it, its class, w, q, whether it is negative, and whether digits other than 0 are lost:
    more than 19 do not fit into w. The class is `WHOLE`, `REAL`, `NAN`, `INFINITE`, or `BAD` for other words.

    table : (256,) uint8, class of each byte value
    """
    first = _byte(data, at)
    negative = first == 45
    at += 1 if negative or first == 43 else 0
    begin, q, form, cut = at, 0, WHOLE, False
    at, w = _few_digits(data, at, u64(0))
    count = at - begin
    if _kind(table, data, at) == DOT:
        form, dot = REAL, at
        at, w = _few_digits(data, dot + 1, w)
        q = dot + 1 - at
        count -= q
    if count > DIGITS:
        q, (at, w, kept, lost, cut) = 0, _digits(data, begin, u64(0), 0, 0)
        if form == REAL:
            dot, (at, w, kept, lost, more) = at, _digits(data, at + 1, w, kept, lost)
            cut = cut or more
            q = dot + 1 - at
        q += lost
    if count == 0:
        form = _word(data, at) if form == WHOLE else BAD
        at += 3 if form != BAD else 0
    elif _byte(data, at) | 32 == 101:
        end, e = _exponent(data, at + 1)
        form, at, q = (REAL, end, q + e) if end >= 0 else (BAD, at, q)
    kind = _kind(table, data, at)
    if kind < BLANK:
        form = BAD
        while kind < BLANK:
            at += 1
            kind = _kind(table, data, at)
    return at, form, w, q, negative, cut


@inline
def _store(number: Number, begin: int, mode: int, powers: Array, stats: Array, out: Array, item: int) -> int:
    """Store the number of a parsed word in `out[item]` as the mode of its column requires.

    Return 1 if Python's float must parse the word later, -1 if an integer was expected but not found, else 0.

    number : (end, class, w, q, negative, digits lost) of the word, whose value is w * 10^q
    begin : offset of the word; powers : table of the leading 128 bits of the powers of ten
    mode : SKIP (store 0), FLOAT (store the bits of a float64), INT (store an int64), or SCAN (like INT, but any number
    is accepted, and only integers are stored)
    stats : (3,) int64, updated for INT and SCAN with whether all numbers of the column are integers, the minimum and
    the maximum
    out : (n,) int64
    """
    _, form, w, q, negative, cut = number
    if mode == FLOAT:
        bits = _bits(number, powers)
        out[item] = bits if bits != -1 else MARK | begin
        return 1 if bits == -1 else 0
    if mode == SKIP:
        out[item] = 0
        return 0
    if form != WHOLE or cut or q != 0 or w >> u64(63) != u64(0):
        stats[IS_WHOLE] = 0
        return -1 if mode == INT else 0
    value = -i64(w) if negative else i64(w)
    stats[LEAST], stats[MOST] = min(stats[LEAST], value), max(stats[MOST], value)
    out[item] = value
    return 0


@inline
def _line(
    data: Array, at: int, setting: Array, powers: Array, stats: Array, out: Array, item: int
) -> tuple[int, int, int, int]:
    """Parse the line at an offset; store one number per column in `out`, int64, from index `item` on.

    Return the offset where parsing ends, a status, the offset of the error, and the number of words that Python's float
    must parse later. The status is FINE, COLUMNS (wrong number of columns), SINGLE (only one column) or NOT_WHOLE (not
    the integer expected).

    data : (bytes,) uint8; powers : table of the leading 128 bits of the powers of ten
    setting : (257 + k,) uint8, class of each byte value, whether there are comments, mode of each of k columns
    stats : (k, 3) int64, updated with whether a column has integers only, its minimum and its maximum
    """
    table, modes, k = setting[:256], setting[257:], len(setting) - 257
    empty = (at, NAN, u64(0), 0, False, False)
    begin, column, odd = at, 0, 0
    awaited = False  # whether a delimiter has been read, with nothing after it yet
    kind = _kind(table, data, at)
    while kind != END:
        if kind == BLANK:
            at += 1
        elif kind == DELIMITER and not awaited and column > 0:
            at += 1
            awaited = True
        elif column == k:
            return at, COLUMNS, begin, odd
        else:
            start, awaited = at, kind == DELIMITER
            if modes[column] == SKIP and not awaited:
                number = empty
                while kind < BLANK:
                    at += 1
                    kind = _kind(table, data, at)
            else:
                number = empty if awaited else _token(data, at, table)
                at = at + 1 if awaited else number[0]
            stored = _store(number, start, modes[column], powers, stats[column], out, item + column)
            if stored < 0:
                return at, NOT_WHOLE, start, odd
            odd += stored
            column += 1
        kind = _kind(table, data, at)
    if awaited and column == k - 1:
        if _store(empty, at, modes[column], powers, stats[column], out, item + column) < 0:
            return at, NOT_WHOLE, at, odd
        column += 1
    return at, FINE if column == k else SINGLE if column == 1 else COLUMNS, begin, odd


@inline
def _is_comment(data: Array, at: int) -> bool:
    return _byte(data, at) == 35 or (_byte(data, at) == 47 and _byte(data, at + 1) == 47)


@kernel
def parse_pieces(
    work: Array, data: Array, pieces: Array, setting: Array, powers: Array, out: Array, states: Array, stats: Array
) -> None:
    """Parse the numbers of a text of k columns, which is divided into p pieces of whole lines for threads.

    work : counter from which threads take pieces; data : (bytes,) uint8, the text
    pieces : (p + 1,) int64, offset of the first byte of each piece, then the length of the text
    setting : (257 + k,) uint8, class of each byte value, whether there are comments, mode of each column
    powers : table of the leading 128 bits of the powers of ten
    out : (bytes,) int64, receives integers or bits of float64, row by row; those of piece t begin at `out[pieces[t]]`
    states : (p, 4) int64, receives for each piece the number of rows, why parsing ends (FINE or an error), the offset
    where it ends, and the number of words that Python's float must parse later
    stats : (p, k, 3) int64, receives whether a column of a piece has integers only, its minimum and its maximum, for
    columns in mode INT or SCAN
    """
    data, out, setting, powers, stats = borrow(data), borrow(out), borrow(setting), borrow(powers), borrow(stats)
    k = len(setting) - 257
    t = next_tile(work)
    while t >= 0:
        at, end = pieces[t], pieces[t + 1]
        row, odd, why, where = 0, 0, FINE, end
        while at < end:
            kind = _kind(setting, data, at)
            if kind == BLANK or kind == END:  # noqa: SIM109  # `in` would create a tuple
                at += 1
            elif setting[256] != 0 and _is_comment(data, at):
                while _kind(setting, data, at) != END:
                    at += 1
            else:
                at, why, place, more = _line(data, at, setting, powers, stats[t], out, pieces[t] + row * k)
                if why != FINE:
                    where = place
                    break
                odd += more
                row += 1
        states[t, ROWS], states[t, WHY], states[t, WHERE], states[t, ODD] = row, why, where, odd
        t = next_tile(work)
