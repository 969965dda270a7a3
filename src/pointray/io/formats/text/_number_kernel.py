"""The compiled part of reading numbers from text, see `_numbers`.

A number's digits are read as a whole number w and a power of ten q, and w * 10^q becomes the nearest float64 in whole
numbers alone (Lemire, Number parsing at a gigabyte per second, 2021): kernels may replace a division by a product,
which would change last bits. What that cannot do (subnormal numbers, more than 19 digits that decide, words) is left to
Python's float.
"""

from __future__ import annotations

from ....engine.jit import Array, borrow, i64, inline, kernel, next_tile, u64

OTHER, DIGIT, DOT, BLANK, DELIMITER, END = range(6)  # what a byte is; from BLANK on it separates
SKIP, FLOAT, SCAN, INT = range(4)  # what becomes of a column: nothing, float64, its limits if whole, int64
WHOLE, REAL, NAN, INFINITE, BAD = range(5)  # what a token is
FINE, COLUMNS, SINGLE, NOT_WHOLE = range(4)  # why a piece ends
ROWS, WHY, WHERE, ODD, STATES = range(5)  # columns of the table of pieces
IS_WHOLE, LEAST, MOST, STATS = range(4)  # what is noted of columns
MARK = 0x7FFC << 48  # a NaN with the offset of a token that is left to Python in its low bits
NOT_A_NUMBER, INFINITY, SIGN_BIT = 0x7FF8 << 48, 0x7FF0 << 48, -(1 << 63)
LOWEST, HIGHEST = -342, 308  # powers of ten in the table
DIGITS = 19  # that a whole number of 64 bits always holds

Number = tuple[int, int, int, int, bool, bool]


@inline
def _byte(data: Array, at: int) -> int:
    """A byte; an index without a sign is not checked for counting from the end."""
    return i64(data[u64(at)])


@inline
def _kind(table: Array, data: Array, at: int) -> int:
    return i64(table[data[u64(at)]])


@inline
def _product(a: int, b: int) -> tuple[int, int]:
    """The upper and the lower 64 bits of a product."""
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
    """The bits of the float64 nearest to w * 10^q, w > 0; -1 if it is subnormal."""
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
        mantissa -= u64(1)  # exactly between two numbers: to the even one
    mantissa = (mantissa + (mantissa & u64(1))) >> u64(1)
    if mantissa >> u64(53) != u64(0):
        mantissa = mantissa >> u64(1)
        power += 1
    if power <= 0 or power >= 2047:
        return -1 if power <= 0 else INFINITY
    return i64(mantissa & u64((1 << 52) - 1)) | (power << 52)


@inline
def _bits(number: Number, powers: Array) -> int:
    """The bits of a token as float64; -1 if Python must read it."""
    _, form, w, q, negative, cut = number
    bits = NOT_A_NUMBER if form == NAN else INFINITY if form == INFINITE else 0
    if form == WHOLE or form == REAL:  # noqa: SIM109  # a tuple would be made
        if w != u64(0):
            bits = _float_bits(w, q, powers)
        if cut and bits != _float_bits(w + u64(1), q, powers):
            bits = -1
    if form == BAD or bits == -1:
        return -1
    return bits | SIGN_BIT if negative else bits


@inline
def _digits(data: Array, at: int, w: int, kept: int, lost: int) -> tuple[int, int, int, int, bool]:
    """Reads digits: where they end, w with them, how many count in it, how many are lost, if one of these is not 0."""
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
    """Reads digits, at most 19 of which count: where they end, and w with them."""
    d = _byte(data, at) - 48
    while 0 <= d <= 9:
        w = w * u64(10) + u64(d)
        at += 1
        d = _byte(data, at) - 48
    return at, w


@inline
def _word(data: Array, at: int) -> int:
    """What three letters are."""
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
    """Reads what follows an e; where it ends, -1 if it has no digits, and its value."""
    sign = _byte(data, at)
    at += 1 if sign == 45 or sign == 43 else 0
    begin, value = at, 0
    d = _byte(data, at) - 48
    while 0 <= d <= 9:
        value = min(10 * value + d, 1 << 30)  # far more than a line has digits
        at += 1
        d = _byte(data, at) - 48
    return at if at > begin else -1, -value if sign == 45 else value


@inline
def _token(data: Array, at: int, table: Array) -> Number:
    """Reads a token: where it ends, what it is, w, q, its sign, and whether digits that are not 0 are left out of w."""
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
    """Stores a token; 1 if Python must read it, -1 if a whole number was expected."""
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
    """Parses a line into items from `item` on: where it ends, what is wrong with it, where, tokens left to Python."""
    table, modes, k = setting[:256], setting[257:], len(setting) - 257
    empty = (at, NAN, u64(0), 0, False, False)
    begin, column, odd = at, 0, 0
    awaited = False  # whether a delimiter has been read, and nothing behind it
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
) -> int:
    """Parses pieces of text, each into the items of `out` that begin with the number of its first byte.

    data : (bytes,) uint8; pieces : (p + 1,) int64, where they begin, after the end of a line
    setting : (257 + k,) uint8, what each byte is, 1 if there are comments, what becomes of each column
    out : (bytes,) int64, row after row; states : (p, STATES) int64; stats : (p, k, STATS) int64
    """
    data, out, setting, powers, stats = borrow(data), borrow(out), borrow(setting), borrow(powers), borrow(stats)
    k = len(setting) - 257
    t = next_tile(work)
    while t >= 0:
        at, end = pieces[t], pieces[t + 1]
        row, odd, why, where = 0, 0, FINE, end
        while at < end:
            kind = _kind(setting, data, at)
            if kind == BLANK or kind == END:  # noqa: SIM109  # a tuple would be made
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
    return 0
