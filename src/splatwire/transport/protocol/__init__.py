"""The transport protocol without sockets and clocks: datagrams, sender, receiver, schedule, feedback."""
