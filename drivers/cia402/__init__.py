"""CiA 402 (IEC 61800-7-201): what the standard says of a drive, and no wire.

Tables without I/O, for drive and master alike: `objects`, `state_machine`, `modes`, `words`, `error_codes`. Over a wire: `units`,
`power`, `operation_modes`, `own_limits`, `motion`, `homing`, and `drive`, which joins them to a `ServoDrive`.

A wire gives (EtherCAT's, for instance: CoE for the objects, the cyclic process data for the image):

- `wire.ObjectAccess`: one object read, read if shown, or written, each answered before the call returns; a refusal with its code;
- `wire.ProcessImage`: the values received last and when, and `refresh`, which returns values of a later moment than the call;
- a subclass of `drive.Cia402Drive`: `open` connects and calls `_take_up`, nothing enabled or moved; `_send_word` sends a controlword
  that stops, at once, by every way, without waiting or a lock; `_glance` and `_look` show the axis while it is shut down;
  `_put_back`, `_answers` and `_release` end it; `capabilities`, and `_stream` where set-points are cyclic.

`tests/support/cia402_wires.py` has the smallest one; `tests/contract/test_cia402.py` is run over each.
"""
