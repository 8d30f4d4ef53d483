"""CiA 402 servo drives on the CANopen stack `durand`, written from CiA 301 and CiA 402-2 for the tests alone.

Nothing of this project is imported here: what the tests show of the master does not rest on code that it shares.
"""
