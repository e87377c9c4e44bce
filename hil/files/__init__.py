"""Verbs on files and buses: records, tables of controllers, sealed files, ISO 230 figures, drives and who is on the bus."""
