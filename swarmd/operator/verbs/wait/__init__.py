"""The verb `wait`: waits until robots are as they are wanted."""
