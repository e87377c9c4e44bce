"""The simulated side: a machine that behaves like one, shown through the protocols that real machines speak.

What may go in: truth physics (`plant`, numbers only), the drive firmware around it (`servo`), one module per face that shows it
(in-process, CANopen, Modbus, laser), the simulated clock, and faults as data. It may use the drivers' abstractions and no-I/O
tables; it never sees `hil`, so that nothing it proves can lean on what is being proven.
"""
