"""The command `splatwire`: one file per verb; heavy libraries are loaded only by the verb that runs."""
