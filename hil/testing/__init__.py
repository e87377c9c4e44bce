"""Tests of users' scripts: fixtures of pytest with a simulated axis, a simulated drive on a CAN bus, and faults."""
