"""Congestion control of a sender: pacing, estimates of queuing delay and loss, congestion windows."""
