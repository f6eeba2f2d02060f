"""What the commands print, ask and complete."""
