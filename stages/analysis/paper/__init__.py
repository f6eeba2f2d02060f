"""Our figures beside those that the paper prints, table by table."""
