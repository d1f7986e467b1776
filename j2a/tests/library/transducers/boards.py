"""A board with transducers of each sort, and one that says anything of its own."""

from j2a_spec import constants as c

import j2a
from j2a.types.transds_file import read_transds

FILE = """
J2A_ENUM(mode, u8, (off, 0), (on, 5))
J2A_STRUCT(motion, (array(i16, 3), rate, mdeg/s), (bool, up))
SENSOR(quad, 0, quad, HEDS-6500, 2, int16_t, -1, (unit, deg), (scale, 0.5), (offset, 10),
       (decimation, 1), (threshold, 0), (topic, wheels), "The wheels.")
SENSOR(log, 1, log, X, 2, u8, none, (queue, 3))
SENSOR(imu, 2, imu, X, 1, motion, none, (trigger))
SENSOR(level, 3, level, X, 1, float, nan)
SENSOR(state, 4, state, X, 1, mode, none)
ACTUATOR(servo, 10, servo, SG90, 2, int8_t, 5, (unit, %), (range, -100, 100), (watchdog, 0))
ACTUATOR(lamp, 11, lamp, X, 1, bool, none)
ACTUATOR(heat, 12, heat, X, 1, u16, none, (unit, Cel), (scale, 0.1), (offset, -50),
         (range, 0, 1500))
ACTUATOR(tiny, 13, tiny, X, 1, f32, none, (scale, 1e-300))
ACTUATOR(part, 14, part, X, 1, f32, none, (range, -0.1, 0.1))
SENSOR(cold, 15, cold, X, 1, f32, -999.9)
SENSOR(field, 16, field, X, 2, array(i16, 3), none, (unit, uT), (scale, 0.5), (offset, -1))
ACTUATOR(pose, 17, pose, X, 1, array(i16, 2), none, (unit, deg), (scale, 0.1))
"""


def skip(device, count):
    """Have the device count SIFs that never go out, as those are that a link loses."""
    for connection in device._connections:
        for _ in range(count):
            connection._server.skip_sif()


ONE_SENSOR = b"\nsensor a 1 1 u8\n"


def make_device(text=FILE, **options):
    return j2a.Device(transducers=read_transds(text), **options)


def talking(content, answer=lambda payload: (0, payload[2:]), **options):
    """A device whose a2jGetTransds returns any bytes, and a2jTransd what `answer` says."""
    made = j2a.Device({"j2a.caps": "transducers"}, **options)
    made._table.add_content(c.GET_TRANSDS, lambda: content)
    made._table.add_call(c.TRANSD, answer)
    return made
