"""What a workflow's results are kept in: artifacts by their content, actions by what they depend on."""
