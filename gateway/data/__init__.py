"""Measured data: tables, visits, recordings. Imports no hardware."""
