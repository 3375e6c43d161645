"""The command line, its help and schemas, and the same functions as tools for agents (MCP)."""
