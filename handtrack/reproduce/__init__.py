"""Published tables and figures of the sources, theirs beside ours."""
