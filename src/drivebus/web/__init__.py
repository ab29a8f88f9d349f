"""The web part: a process of its own and a client of the plant. It can be killed, and the plant goes on."""
