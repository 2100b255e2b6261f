"""The database itself: connections, transactions, tables, revisions, copies and recovery."""
