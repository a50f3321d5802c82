"""Parquet files of numbers, written byte by byte: the compact protocol of Thrift, and plain pages."""

import struct


def varint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes(out) + bytes([value])


def integer(value):
    return varint(value << 1)


def field(delta, kind, value):
    return bytes([delta << 4 | kind]) + value


def listed(kind, *elements):
    size = bytes([len(elements) << 4 | kind]) if len(elements) < 15 else bytes([0xF0 | kind]) + varint(len(elements))
    return size + b"".join(elements)


def text(value):
    return varint(len(value)) + value.encode()


def _levels(bits):
    """Pack levels of one bit."""
    groups = -(-len(bits) // 8)
    packed = sum(bit << i for i, bit in enumerate(bits)).to_bytes(groups, "little")
    run = varint(groups << 1 | 1) + packed
    return len(run).to_bytes(4, "little") + run


def _element(name, kind=None, repetition=None, children=None):
    out, last = b"", 0
    for number, value in ((1, kind), (3, repetition), (4, name), (5, children)):
        if value is not None:
            out += field(number - last, *((8, text(value)) if number == 4 else (5, integer(value))))
            last = number
    return out + b"\0"


def parquet(columns):
    """Return a file with one row group. columns: name -> integers, numbers or lists of numbers, one per row."""
    int64, double = 2, 5
    rows = len(next(iter(columns.values())))
    schema, chunks, body = [_element("root", children=len(columns))], [], b"PAR1"
    for name, values in columns.items():
        path, levels = [name], b""
        if isinstance(values[0], (list, tuple)):
            kind, path = double, [name, "list", "element"]
            schema += [_element(name, repetition=0, children=1), _element("list", repetition=2, children=1),
                       _element("element", kind, 0)]
            entries = [(v, int(k > 0)) for row in values for k, v in enumerate(row)]
            levels = _levels([repeats for _, repeats in entries]) + _levels([1] * len(entries))
            values = [v for v, _ in entries]
        else:
            kind = int64 if isinstance(values[0], int) else double
            schema.append(_element(name, kind, 0))
        data = levels + struct.pack(f"<{len(values)}{'q' if kind == int64 else 'd'}", *values)
        counts = b"".join(field(1, 5, integer(v)) for v in (len(values), 0, 3, 3)) + b"\0"
        header = b"".join(field(1, 5, integer(v)) for v in (0, len(data), len(data))) + field(2, 12, counts) + b"\0"
        size = len(header) + len(data)
        meta = (field(1, 5, integer(kind)) + field(1, 9, listed(5, integer(0)))
                + field(1, 9, listed(8, *map(text, path))) + field(1, 5, integer(0))
                + b"".join(field(1, 6, integer(v)) for v in (len(values), size, size))
                + field(2, 6, integer(len(body))) + b"\0")
        chunks.append(field(3, 12, meta) + b"\0")
        body += header + data
    group = field(1, 9, listed(12, *chunks)) + field(1, 6, integer(len(body))) + field(1, 6, integer(rows)) + b"\0"
    footer = (field(1, 5, integer(1)) + field(1, 9, listed(12, *schema)) + field(1, 6, integer(rows))
              + field(1, 9, listed(12, group)) + b"\0")
    return body + footer + len(footer).to_bytes(4, "little") + b"PAR1"
