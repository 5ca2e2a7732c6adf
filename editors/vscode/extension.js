// Starts `pycram-replay debug --dap` for each debug session; its commands are commands of the debugger's prompt.
"use strict";

const vscode = require("vscode");

/** Lets the debugger's prompt carry out a command, and shows what it printed. */
async function command(text) {
  const session = vscode.debug.activeDebugSession;
  if (session === undefined || session.type !== "pycram") {
    vscode.window.showInformationMessage("PyCRAM: debug a recording first");
    return;
  }
  try {
    const answer = await session.customRequest("evaluate", { expression: text, context: "repl" });
    vscode.debug.activeDebugConsole.appendLine(answer.result);
  } catch (error) {
    vscode.window.showErrorMessage(`PyCRAM: ${error.message}`);
  }
}

async function goTo() {
  const step = await vscode.window.showInputBox({ prompt: "A step, a time as 2.5s, or task:PATH", value: "failure" });
  if (step) {
    await command(`goto ${step}`);
  }
}

function adapter(session) {
  const folder = session.workspaceFolder?.uri.fsPath ?? "";
  const named = vscode.workspace.getConfiguration("pycram-replay", session.workspaceFolder).get("command");
  const options = folder ? { cwd: folder } : undefined;
  return new vscode.DebugAdapterExecutable(named.replace("${workspaceFolder}", folder), ["debug", "--dap"], options);
}

function activate(context) {
  context.subscriptions.push(
    vscode.debug.registerDebugAdapterDescriptorFactory("pycram", { createDebugAdapterDescriptor: adapter }),
    vscode.commands.registerCommand("pycram-replay.view", () => command("view")),
    vscode.commands.registerCommand("pycram-replay.why", () => command("why")),
    vscode.commands.registerCommand("pycram-replay.goto", goTo),
  );
}

module.exports = { activate };
