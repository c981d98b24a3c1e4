"""Methods that go down a block tree, ended at an error that held-out pictures tell."""
