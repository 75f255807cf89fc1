"""Lines that a command may write to stderr while it works, beside an error."""

#: How warnings and, where a stage takes a second or more, words of its progress begin.
WARNING, PROGRESS = "sightline: warning: ", "sightline: progress: "
