"""The stages that workflows can name, one per module, and the packages that implement them."""
