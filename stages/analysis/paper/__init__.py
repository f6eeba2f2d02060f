"""Our figures laid beside those that the paper prints, table by table."""
