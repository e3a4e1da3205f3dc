"""Published tables and figures of the seeds, theirs beside ours."""
