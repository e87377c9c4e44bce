"""The simulated side: a machine with its drives and instruments, shown through the protocols of real ones.

Contains truth physics (`plant`, numbers only), the drive firmware around it (`servo`), one module per face that shows it
(in-process, CANopen, Modbus, laser), the simulated clock, and faults as data. It may use the drivers' abstractions and no-I/O
tables; it never imports `hil`, so that its results are independent of the code under test.
"""
