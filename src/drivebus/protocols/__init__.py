"""Bytes to messages and back, one module a protocol. Sans-IO: no clock, no port, no log; no protocol knows another."""
